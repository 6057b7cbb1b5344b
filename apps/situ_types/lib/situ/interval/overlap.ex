defmodule Situ.Interval.Overlap do
  @moduledoc false
  # Compares two intervals whose smaller end is on the left. Results are `{left, left_inclusive, right,
  # right_inclusive}`, from which `Situ.Interval` builds intervals.

  @type interval :: Situ.Interval.t()
  @type ends :: {Situ.Interval.bound(), boolean(), Situ.Interval.bound(), boolean()}

  @doc "Returns the ends of the intersection of two non-empty intervals, or `nil` if they are disjoint."
  @spec common_ends(interval(), interval()) :: ends() | nil
  def common_ends(a, b) do
    {left, left_inclusive} = later_left(a, b)
    {right, right_inclusive} = earlier_right(a, b)

    cond do
      left == :unbounded or right == :unbounded or left < right -> :overlap
      left == right and left_inclusive and right_inclusive -> :overlap
      true -> nil
    end && {left, left_inclusive, right, right_inclusive}
  end

  @doc "Returns whether `b` contains every point of `a`, which must not be empty."
  @spec fits_within?(interval(), interval()) :: boolean()
  def fits_within?(a, b), do: left_within?(a, b) and right_within?(a, b)

  @doc "Returns the ends of the smallest interval that contains both."
  @spec covering_ends(interval(), interval()) :: ends()
  def covering_ends(a, b) do
    {left, left_inclusive} = if left_within?(a, b), do: left_end(b), else: left_end(a)
    {right, right_inclusive} = if right_within?(a, b), do: right_end(b), else: right_end(a)
    {left, left_inclusive, right, right_inclusive}
  end

  defp later_left(%{left: :unbounded}, b), do: {b.left, b.left_inclusive}
  defp later_left(a, %{left: :unbounded}), do: {a.left, a.left_inclusive}

  defp later_left(a, b) do
    cond do
      a.left > b.left -> {a.left, a.left_inclusive}
      a.left < b.left -> {b.left, b.left_inclusive}
      true -> {a.left, a.left_inclusive and b.left_inclusive}
    end
  end

  defp earlier_right(%{right: :unbounded}, b), do: {b.right, b.right_inclusive}
  defp earlier_right(a, %{right: :unbounded}), do: {a.right, a.right_inclusive}

  defp earlier_right(a, b) do
    cond do
      a.right < b.right -> {a.right, a.right_inclusive}
      a.right > b.right -> {b.right, b.right_inclusive}
      true -> {a.right, a.right_inclusive and b.right_inclusive}
    end
  end

  defp left_within?(_a, %{left: :unbounded}), do: true
  defp left_within?(%{left: :unbounded}, _b), do: false

  defp left_within?(a, b),
    do: a.left > b.left or (a.left == b.left and (b.left_inclusive or not a.left_inclusive))

  defp right_within?(_a, %{right: :unbounded}), do: true
  defp right_within?(%{right: :unbounded}, _b), do: false

  defp right_within?(a, b),
    do: a.right < b.right or (a.right == b.right and (b.right_inclusive or not a.right_inclusive))

  defp left_end(i), do: {i.left, i.left_inclusive}
  defp right_end(i), do: {i.right, i.right_inclusive}
end
