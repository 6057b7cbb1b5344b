defmodule Situ.CLI.Store.Lag do
  @moduledoc false
  # How far the messages of a stream lie behind the newest ones made before them, when all are read in the order of
  # their originating times: a replay in that order waits so long for the stream.
  alias Situ.CLI.Store.Tape
  alias Situ.Store

  @doc "`[%{stream, average, most}]`, ns, those that lag most first by `order`."
  @spec of(Store.Handle.t(), :average | :most) :: [map()]
  def of(store, order) do
    tagged =
      for info <- Store.streams(store),
          do: {info.name, Store.messages(store, info, envelopes: true, skip_damage: true)}

    {_, lags} =
      tagged
      |> Tape.merge(& &1.originating_time)
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
