defmodule Situ.Store.Summary.Bins do
  @moduledoc false
  # Computes signals and their bins. Pure.
  import Bitwise
  import Kernel, except: [floor: 1]

  @doc "Combines points in time order into bins of width 2^level."
  @spec fold(Enumerable.t(), non_neg_integer()) :: [Situ.Store.Summary.bin()]
  def fold(points, level) do
    points
    |> Stream.chunk_by(fn {time, _, _, _, _} -> bsr(time, level) end)
    |> Enum.map(fn [{time, min, max, last, n} | rest] ->
      Enum.reduce(rest, {floor(time, level), min, max, last, n}, &absorb/2)
    end)
  end

  defp absorb({_, low, high, last, n}, {start, min, max, _, count}),
    do: {start, min(min, low), max(max, high), last, count + n}

  @doc "Returns the start of the bin of width 2^level that contains `time`."
  @spec floor(Situ.Time.t(), non_neg_integer()) :: Situ.Time.t()
  def floor(time, level), do: time |> bsr(level) |> bsl(level)

  @doc "Returns the points of the signal in one message, by its codec or as a number."
  @spec points(Situ.Message.t()) :: [Situ.Codec.point()]
  def points(%{data: data, originating_time: time}) when is_number(data),
    do: [{time, data / 1, data / 1, data / 1, 1}]

  def points(%{data: true} = message), do: points(%{message | data: 1})
  def points(%{data: false} = message), do: points(%{message | data: 0})

  def points(%{data: %module{} = data, originating_time: time}) do
    if Situ.Codec.implemented_by?(module) and function_exported?(module, :points, 2),
      do: module.points(data, time),
      else: []
  end

  def points(_), do: []
end
