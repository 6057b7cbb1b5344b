defmodule Situ.Studio.Color do
  @moduledoc """
  Which of the page's colours a stream has: the same in every panel, by its place among all streams. The colours
  themselves are in the style sheet; here they are numbers.

      iex> ranks = Situ.Studio.Color.ranks(["Mic.Level", "Imu.Y", "Imu.X"])
      iex> Situ.Studio.Color.of(["Imu.Y", "Mic.Level"], ranks)
      [1, 2]

  Two streams of one panel differ: the second that would have a colour takes the next one that is free.

      iex> Situ.Studio.Color.of(["a", "b", "c"], %{"a" => 3, "b" => 11, "c" => 4})
      [3, 4, 5]
  """
  alias Situ.Studio.NaturalOrder

  @colors 8

  @doc "The place of each of all streams; a derived one (`= ...`) comes after them, and changes no other's."
  @spec ranks([String.t()]) :: %{optional(String.t()) => non_neg_integer()}
  def ranks(names) do
    names
    |> Enum.sort_by(&{String.starts_with?(&1, "= "), NaturalOrder.key(&1)})
    |> Enum.with_index()
    |> Map.new()
  end

  @doc "The colours of the streams of one panel, in their order."
  @spec of([String.t()], map()) :: [0..7]
  def of(streams, ranks) do
    {colors, _} =
      Enum.map_reduce(streams, MapSet.new(), fn stream, taken ->
        color = stream |> own(ranks) |> free(taken)
        {color, MapSet.put(taken, color)}
      end)

    colors
  end

  defp own(stream, ranks), do: rem(Map.get(ranks, stream, 0), @colors)

  defp free(color, taken) do
    Enum.find(color..(color + @colors - 1), color, &(rem(&1, @colors) not in taken))
    |> rem(@colors)
  end
end
