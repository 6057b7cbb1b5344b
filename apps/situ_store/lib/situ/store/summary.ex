defmodule Situ.Store.Summary do
  @moduledoc false
  # Summaries of readers that keep no pyramid: every message is read.
  alias Situ.Store.Native

  @spec fold(Situ.Store.t(), Situ.Store.StreamInfo.t(), integer(), integer(), pos_integer()) ::
          {:ok, pos_integer(), [tuple()]} | {:error, Situ.Error.t()}
  def fold(store, info, from, to, pixels) do
    level = Native.summary_level(from, to, pixels)
    width = Bitwise.bsl(1, level)

    bins =
      store
      |> Situ.Store.messages(info, from: from, to: to)
      |> Stream.flat_map(&points/1)
      |> Stream.filter(fn {time, _, _, _, _} -> time >= from and time <= to end)
      |> Stream.chunk_by(fn {time, _, _, _, _} -> Bitwise.bsr(time, level) end)
      |> Enum.map(fn [first | rest] ->
        Enum.reduce(rest, start(first, level), fn {_, low, high, last, n},
                                                  {t, min, max, _, count} ->
          {t, min(min, low), max(max, high), last, count + n}
        end)
      end)

    {:ok, width, bins}
  rescue
    error in Situ.Error -> {:error, error}
  end

  defp start({time, min, max, last, count}, level),
    do: {time |> Bitwise.bsr(level) |> Bitwise.bsl(level), min, max, last, count}

  defp points(%{data: number, originating_time: time}) when is_number(number),
    do: [{time, number / 1, number / 1, number / 1, 1}]

  defp points(%{data: true} = message), do: points(%{message | data: 1})
  defp points(%{data: false} = message), do: points(%{message | data: 0})

  defp points(%{data: %module{} = data, originating_time: time}) do
    if Code.ensure_loaded?(module) and function_exported?(module, :points, 2),
      do: module.points(data, time),
      else: []
  end

  defp points(_), do: []
end
