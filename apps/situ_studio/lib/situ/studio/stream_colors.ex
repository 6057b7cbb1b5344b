defmodule Situ.Studio.StreamColors do
  @moduledoc false
  # Assigns colors to streams. A stream has the same color in every panel, given by its rank among
  # all streams. The colors themselves are in the style sheet; here they are numbers.
  #
  # Streams in one panel have different colors: a stream whose color is taken gets the next free
  # one.
  alias Situ.Studio.NaturalOrder

  @colors 8

  @doc """
  Ranks all streams. Derived streams (`= ...`) come last, so they do not change the rank of other
  streams.

      iex> ranks = Situ.Studio.StreamColors.rank_streams(["Mic.Level", "Imu.Y", "Imu.X"])
      iex> Situ.Studio.StreamColors.assign_colors(["Imu.Y", "Mic.Level"], ranks)
      [1, 2]
  """
  @spec rank_streams([String.t()]) :: %{optional(String.t()) => non_neg_integer()}
  def rank_streams(names) do
    names
    |> Enum.sort_by(&{String.starts_with?(&1, "= "), NaturalOrder.sort_key(&1)})
    |> Enum.with_index()
    |> Map.new()
  end

  @doc """
  Returns the colors of the streams of one panel, in order.

      iex> Situ.Studio.StreamColors.assign_colors(["a", "b", "c"], %{"a" => 3, "b" => 11, "c" => 4})
      [3, 4, 5]
  """
  @spec assign_colors([String.t()], map()) :: [0..7]
  def assign_colors(streams, ranks) do
    {colors, _} =
      Enum.map_reduce(streams, MapSet.new(), fn stream, taken ->
        color = stream |> base_color(ranks) |> next_free_color(taken)
        {color, MapSet.put(taken, color)}
      end)

    colors
  end

  defp base_color(stream, ranks), do: rem(Map.get(ranks, stream, 0), @colors)

  defp next_free_color(color, taken) do
    Enum.find(color..(color + @colors - 1), color, &(rem(&1, @colors) not in taken))
    |> rem(@colors)
  end
end
