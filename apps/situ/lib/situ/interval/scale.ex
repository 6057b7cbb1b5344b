defmodule Situ.Interval.Scale do
  @moduledoc false
  # Moving the ends of an interval: unbounded ones stay.
  alias Situ.Interval

  @type amount :: {:by, Interval.point()} | {:factor, number()}

  @doc "Both ends outwards by their amounts, each from the span before."
  @spec both(Interval.t(), amount(), amount()) :: Interval.t()
  def both(interval, left, right) do
    %{
      interval
      | left: move(interval.left, negate(growth(interval, left))),
        right: move(interval.right, growth(interval, right))
    }
  end

  @doc "Half of the amount at each end; halves of whole numbers are rounded outwards."
  @spec center(Interval.t(), amount()) :: Interval.t()
  def center(interval, amount) do
    half = {:by, interval |> growth(amount) |> halve()}
    both(interval, half, half)
  end

  @doc "An end moved by so much."
  @spec move(Interval.bound(), Interval.point() | :infinity) :: Interval.bound()
  def move(:unbounded, _by), do: :unbounded
  def move(bound, :infinity), do: bound
  def move(bound, by), do: bound + by

  defp growth(_interval, {:by, amount}), do: amount

  defp growth(interval, {:factor, factor}) do
    case Interval.span(interval) do
      :infinity -> :infinity
      span when is_integer(span) -> round(span * (factor - 1))
      span -> span * (factor - 1)
    end
  end

  defp negate(:infinity), do: :infinity
  defp negate(amount), do: -amount

  defp halve(:infinity), do: :infinity
  defp halve(amount) when is_integer(amount), do: div(amount + sign(amount), 2)
  defp halve(amount), do: amount / 2

  defp sign(n) when n < 0, do: -1
  defp sign(_n), do: 1
end
