defmodule Situ.Interval.Scaling do
  @moduledoc false
  # Moves the ends of an interval. Unbounded ends stay unbounded.

  @type span :: Situ.Interval.point() | :infinity
  @type amount :: {:by, Situ.Interval.point()} | {:factor, number()}

  @doc "Moves each end outwards by its amount, both based on the original span."
  @spec scale_ends(Situ.Interval.t(), span(), amount(), amount()) :: Situ.Interval.t()
  def scale_ends(interval, span, left, right) do
    %{
      interval
      | left: move_bound(interval.left, negate_amount(growth_amount(span, left))),
        right: move_bound(interval.right, growth_amount(span, right))
    }
  end

  @doc "Moves each end outwards by half the amount; halves of odd integers are rounded outwards."
  @spec scale_around_center(Situ.Interval.t(), span(), amount()) :: Situ.Interval.t()
  def scale_around_center(interval, span, amount) do
    half = {:by, span |> growth_amount(amount) |> halve_amount()}
    scale_ends(interval, span, half, half)
  end

  @doc "Moves one end by `by`."
  @spec move_bound(Situ.Interval.bound(), Situ.Interval.point() | :infinity) ::
          Situ.Interval.bound()
  def move_bound(:unbounded, _by), do: :unbounded
  def move_bound(bound, :infinity), do: bound
  def move_bound(bound, by), do: bound + by

  defp growth_amount(_span, {:by, amount}), do: amount
  defp growth_amount(:infinity, {:factor, _factor}), do: :infinity

  defp growth_amount(span, {:factor, factor}) when is_integer(span),
    do: round(span * (factor - 1))

  defp growth_amount(span, {:factor, factor}), do: span * (factor - 1)

  defp negate_amount(:infinity), do: :infinity
  defp negate_amount(amount), do: -amount

  defp halve_amount(:infinity), do: :infinity
  defp halve_amount(amount) when is_integer(amount), do: div(amount + rounding_step(amount), 2)
  defp halve_amount(amount), do: amount / 2

  defp rounding_step(n) when n < 0, do: -1
  defp rounding_step(_n), do: 1
end
