defmodule Situ.Interval.Scale do
  @moduledoc false
  # Moves the ends of an interval. Unbounded ends stay unbounded.

  @type span :: Situ.Interval.point() | :infinity
  @type amount :: {:by, Situ.Interval.point()} | {:factor, number()}

  @doc "Moves each end outwards by its amount, both based on the original span."
  @spec both(Situ.Interval.t(), span(), amount(), amount()) :: Situ.Interval.t()
  def both(interval, span, left, right) do
    %{
      interval
      | left: move(interval.left, negate(growth(span, left))),
        right: move(interval.right, growth(span, right))
    }
  end

  @doc "Moves each end outwards by half the amount; halves of odd integers are rounded outwards."
  @spec center(Situ.Interval.t(), span(), amount()) :: Situ.Interval.t()
  def center(interval, span, amount) do
    half = {:by, span |> growth(amount) |> halve()}
    both(interval, span, half, half)
  end

  @doc "Moves one end by `by`."
  @spec move(Situ.Interval.bound(), Situ.Interval.point() | :infinity) :: Situ.Interval.bound()
  def move(:unbounded, _by), do: :unbounded
  def move(bound, :infinity), do: bound
  def move(bound, by), do: bound + by

  defp growth(_span, {:by, amount}), do: amount
  defp growth(:infinity, {:factor, _factor}), do: :infinity
  defp growth(span, {:factor, factor}) when is_integer(span), do: round(span * (factor - 1))
  defp growth(span, {:factor, factor}), do: span * (factor - 1)

  defp negate(:infinity), do: :infinity
  defp negate(amount), do: -amount

  defp halve(:infinity), do: :infinity
  defp halve(amount) when is_integer(amount), do: div(amount + sign(amount), 2)
  defp halve(amount), do: amount / 2

  defp sign(n) when n < 0, do: -1
  defp sign(_n), do: 1
end
