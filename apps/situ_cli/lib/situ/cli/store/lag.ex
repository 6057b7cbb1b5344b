defmodule Situ.CLI.Store.Lag do
  @moduledoc false
  # Measures how much older the messages of a stream are than the newest message before them, by creation time, when all
  # streams are read in order of originating times. A replay in that order waits this long for the stream.
  alias Situ.CLI.Store.ItemReader
  alias Situ.Store

  @doc "Returns `[%{stream, average, most, messages}]` in ns, sorted by `order`, greatest lag first."
  @spec measure_lags(Store.t(), :average | :most) :: [map()]
  def measure_lags(store, order) do
    tagged =
      for info <- Store.streams(store),
          do: {info.name, Store.messages(store, info, envelopes: true, skip_damage: true)}

    {_, lags} =
      tagged
      |> ItemReader.merge(& &1.originating_time)
      |> Enum.reduce({nil, %{}}, fn {name, message}, {newest, lags} ->
        newest = max(newest || message.creation_time, message.creation_time)
        lag = newest - message.creation_time

        {newest,
         Map.update(lags, name, {lag, lag, 1}, fn {sum, most, n} ->
           {sum + lag, max(most, lag), n + 1}
         end)}
      end)

    lags
    |> Enum.map(fn {name, {sum, most, n}} ->
      %{stream: name, average: sum / n, most: most, messages: n}
    end)
    |> Enum.sort_by(&{-Map.fetch!(&1, order), &1.stream})
  end
end
