defmodule Situ.Store.Summary.Bins do
  @moduledoc false
  # Computes signals and their bins. Pure.
  import Bitwise
  import Kernel, except: [floor: 1]

  @doc "Combines points in time order into bins of width 2^level."
  @spec fold_points(Enumerable.t(), non_neg_integer()) :: [Situ.Store.Summary.bin()]
  def fold_points(points, level) do
    points
    |> Stream.chunk_by(fn {time, _, _, _, _} -> bsr(time, level) end)
    |> Enum.map(fn [{time, min, max, last, n} | rest] ->
      Enum.reduce(rest, {bin_start(time, level), min, max, last, n}, &merge_point/2)
    end)
  end

  defp merge_point({_, low, high, last, n}, {start, min, max, _, count}),
    do: {start, min(min, low), max(max, high), last, count + n}

  @doc "Returns the start of the bin of width 2^level that contains `time`."
  @spec bin_start(Situ.Time.t(), non_neg_integer()) :: Situ.Time.t()
  def bin_start(time, level), do: time |> bsr(level) |> bsl(level)

  @doc "Returns the points of the signal in one message, by its codec or as a number."
  @spec message_points(Situ.Message.t()) :: [Situ.Codec.point()]
  def message_points(%{data: data, originating_time: time}) when is_number(data),
    do: [{time, data / 1, data / 1, data / 1, 1}]

  def message_points(%{data: true} = message), do: message_points(%{message | data: 1})
  def message_points(%{data: false} = message), do: message_points(%{message | data: 0})

  def message_points(%{data: %module{} = data, originating_time: time}) do
    if Situ.Codec.implemented_by?(module) and function_exported?(module, :points, 2),
      do: module.points(data, time),
      else: []
  end

  def message_points(_), do: []
end
