defmodule Situ.Examples.Rectangles do
  @moduledoc """
  Operators, the smallest example: the widths and heights of a stream of rectangles, and how wide they are on average.

      iex> rects = [{0, Situ.Rect.new!(0, 0, 10, 20)}, {100, Situ.Rect.new!(5, 5, 30, 10)}]
      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable(rects) |> Situ.Examples.Rectangles.sizes() end)
      [{10, 20}, {30, 10}]
      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable(rects) |> Situ.Examples.Rectangles.average_width() end)
      [10.0, 20.0]
  """
  alias Situ.Stream

  @doc "`{width, height}` of every rectangle: two streams made of one, and joined again by their times."
  @spec sizes(Stream.t()) :: Stream.t()
  def sizes(rects) do
    widths = Situ.map(rects, & &1.width, type: :number)
    heights = Situ.map(rects, & &1.height, type: :number)
    Situ.join(widths, heights)
  end

  @doc "The average width so far."
  @spec average_width(Stream.t()) :: Stream.t()
  def average_width(rects), do: rects |> Situ.map(& &1.width, type: :number) |> Situ.average()
end
