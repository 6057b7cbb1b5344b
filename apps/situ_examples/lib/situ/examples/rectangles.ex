defmodule Situ.Examples.Rectangles do
  @moduledoc """
  The smallest example of operators: computes the sizes and the average width of a stream of rectangles.

      iex> rects = [{0, Situ.Rect.new!(0, 0, 10, 20)}, {100, Situ.Rect.new!(5, 5, 30, 10)}]
      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable(rects) |> Situ.Examples.Rectangles.rect_sizes() end)
      [{10, 20}, {30, 10}]
      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable(rects) |> Situ.Examples.Rectangles.average_width() end)
      [10.0, 20.0]
  """
  alias Situ.Stream

  @doc "Emits `{width, height}` of every rectangle, by splitting the stream in two and joining the two by time."
  @spec rect_sizes(Stream.t()) :: Stream.t()
  def rect_sizes(rects) do
    widths = Situ.map(rects, & &1.width, type: :number)
    heights = Situ.map(rects, & &1.height, type: :number)
    Situ.join(widths, heights)
  end

  @doc "Emits the average width so far."
  @spec average_width(Stream.t()) :: Stream.t()
  def average_width(rects), do: rects |> Situ.map(& &1.width, type: :number) |> Situ.average()
end
