defmodule Situ.Bridge.Columnar.Join do
  @moduledoc false
  # Joins several streams of a recording into the rows of one table. Each message of the first stream becomes a row,
  # with the nearest (or latest) value of every other stream.
  alias Situ.{Message, Store}

  @batch_rows 10_000

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
  `names` are the streams to join to `on`; `read_opts` are options of `Situ.Store.messages/3`.
  """
  @spec stream_parts(Store.t(), String.t(), [String.t()], keyword(), keyword()) :: Enumerable.t()
  def stream_parts(store, on, names, opts, read_opts) do
    store
    |> Store.messages(on, read_opts)
    |> Stream.chunk_every(@batch_rows)
    |> Stream.map(fn rows ->
      times = Enum.map(rows, & &1.originating_time)
      columns = for name <- names, do: pick_values(store, name, times, opts, read_opts)

      rows
      |> Enum.zip(zip_streams(columns, length(rows)))
      |> Enum.map(fn {message, values} ->
        others = names |> Enum.zip(values) |> Map.new()
        %{message | data: Map.put(others, on, message.data)}
      end)
    end)
  end

  defp zip_streams([], n), do: List.duplicate([], n)
  defp zip_streams(columns, _n), do: Enum.zip_with(columns, & &1)

  # Reads the messages of the other stream once and keeps only the picked values.
  defp pick_values(store, name, [first | _] = times, opts, read_opts) do
    last = List.last(times)
    range = Keyword.merge(Keyword.take(read_opts, [:skip_damage]), from: first, to: last)
    previous = message_or_nil(Store.latest_at(store, name, first - 1))

    {values, remaining, latest} =
      store
      |> Store.messages(name, range)
      |> Enum.reduce({[], times, previous}, fn message, {values, remaining, latest} ->
        {due, remaining} = Enum.split_while(remaining, &(&1 < message.originating_time))

        {Enum.reduce(due, values, &[pick_value(latest, message, &1, opts) | &2]), remaining,
         message}
      end)

    following = if remaining != [], do: message_or_nil(Store.first_at(store, name, last + 1))
    values = Enum.reduce(remaining, values, &[pick_value(latest, following, &1, opts) | &2])
    Enum.reverse(values)
  end

  defp message_or_nil({:ok, %Message{} = message}), do: message
  defp message_or_nil(_), do: nil

  defp pick_value(latest, next, time, opts) do
    match = if opts[:take] == :latest, do: latest, else: nearest_message(latest, next, time)
    if match && within_range?(match, time, opts[:within]), do: match.data
  end

  defp nearest_message(nil, next, _time), do: next
  defp nearest_message(latest, nil, _time), do: latest

  defp nearest_message(latest, next, time),
    do: if(next.originating_time - time < time - latest.originating_time, do: next, else: latest)

  defp within_range?(_one, _time, nil), do: true
  defp within_range?(match, time, within), do: abs(match.originating_time - time) <= within
end
