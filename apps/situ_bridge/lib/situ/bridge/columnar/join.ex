defmodule Situ.Bridge.Columnar.Join do
  @moduledoc false
  # Joins several streams of a recording into the rows of one table. Each message of the first stream becomes a row,
  # with the nearest (or latest) value of every other stream.
  alias Situ.{Message, Store}

  @rows 10_000

  @options [
    on: [type: :string, required: true, doc: "The stream whose messages become the rows."],
    streams: [
      type: {:optional, {:list, :string}},
      default: nil,
      doc: "The names of the streams to join; by default, all streams that fit into a table."
    ],
    take: [
      type: {:in, [:nearest, :latest]},
      default: :nearest,
      doc: "`:nearest`: the value nearest in time; `:latest`: the last value up to that time."
    ],
    within: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "The maximum distance in time (ns); values further away are treated as missing."
    ]
  ]

  @doc "Returns the schema of a join's options."
  @spec join_options() :: keyword()
  def join_options, do: @options

  @doc """
  Returns lists of messages whose data are maps from stream names to values. Enumerating them reads the recording.
  `names` are the streams to join to `on`; `reading` are options of `Situ.Store.messages/3`.
  """
  @spec stream_parts(Store.t(), String.t(), [String.t()], keyword(), keyword()) :: Enumerable.t()
  def stream_parts(store, on, names, opts, reading) do
    store
    |> Store.messages(on, reading)
    |> Stream.chunk_every(@rows)
    |> Stream.map(fn rows ->
      times = Enum.map(rows, & &1.originating_time)
      picked = for name <- names, do: pick_values(store, name, times, opts, reading)

      rows
      |> Enum.zip(zip_streams(picked, length(rows)))
      |> Enum.map(fn {message, values} ->
        others = names |> Enum.zip(values) |> Map.new()
        %{message | data: Map.put(others, on, message.data)}
      end)
    end)
  end

  defp zip_streams([], n), do: List.duplicate([], n)
  defp zip_streams(picked, _n), do: Enum.zip_with(picked, & &1)

  # Reads the messages of the other stream once and keeps only the picked values.
  defp pick_values(store, name, [first | _] = times, opts, reading) do
    last = List.last(times)
    between = Keyword.merge(Keyword.take(reading, [:skip_damage]), from: first, to: last)
    before = message_or_nil(Store.latest_at(store, name, first - 1))

    {done, left, held} =
      store
      |> Store.messages(name, between)
      |> Enum.reduce({[], times, before}, fn message, {done, left, held} ->
        {now, left} = Enum.split_while(left, &(&1 < message.originating_time))
        {Enum.reduce(now, done, &[pick_value(held, message, &1, opts) | &2]), left, message}
      end)

    behind = if left != [], do: message_or_nil(Store.first_at(store, name, last + 1))
    done = Enum.reduce(left, done, &[pick_value(held, behind, &1, opts) | &2])
    Enum.reverse(done)
  end

  defp message_or_nil({:ok, %Message{} = message}), do: message
  defp message_or_nil(_), do: nil

  defp pick_value(held, next, time, opts) do
    one = if opts[:take] == :latest, do: held, else: nearest_message(held, next, time)
    if one && within_range?(one, time, opts[:within]), do: one.data
  end

  defp nearest_message(nil, next, _time), do: next
  defp nearest_message(held, nil, _time), do: held

  defp nearest_message(held, next, time),
    do: if(next.originating_time - time < time - held.originating_time, do: next, else: held)

  defp within_range?(_one, _time, nil), do: true
  defp within_range?(one, time, within), do: abs(one.originating_time - time) <= within
end
