defmodule Situ.Studio.Source.Compared do
  @moduledoc """
  Combines two sources on one time axis. The names of the second source's streams begin with `Compared.`, and all their
  times are shifted by an offset, including the times of intervals inside messages. Streams of the first source with
  such a name are hidden.

      iex> [first, second] = for _ <- 1..2, do: Situ.Studio.History.new(live: false)
      iex> :ok = Situ.Studio.History.put(second, "Level", %Situ.Message{data: 20, originating_time: 5}, 8)
      iex> [first, second] = for history <- [first, second], do: {Situ.Studio.Source.History, history}
      iex> source = Situ.Studio.Source.Compared.combine_sources(first, second, 100)
      iex> {:ok, message} = Situ.Studio.Source.call(source, :latest_at, ["Compared.Level", 200])
      iex> {message.originating_time, message.data}
      {105, 20}
  """
  @behaviour Situ.Studio.Source

  alias Situ.{Interval, Message}
  alias Situ.Studio.{Gap, Source}

  @prefix "Compared."
  @starts [:start, :stop, :end, "start", "stop", "end"]

  @enforce_keys [:first, :second, :offset]
  defstruct [:first, :second, :offset]

  @type t :: %__MODULE__{first: Source.t(), second: Source.t(), offset: Situ.Time.duration()}

  @doc "Combines two sources and shifts the second by `offset` ns."
  @spec combine_sources(Source.t(), Source.t(), Situ.Time.duration()) :: Source.t()
  def combine_sources(first, second, offset),
    do: {__MODULE__, %__MODULE__{first: first, second: second, offset: offset}}

  @doc """
  Returns whether a stream belongs to the second source.

      iex> Enum.map(["Compared.Level", "Level"], &Situ.Studio.Source.Compared.compared_stream?/1)
      [true, false]
  """
  @spec compared_stream?(String.t()) :: boolean()
  def compared_stream?(name), do: String.starts_with?(name, @prefix)

  @doc "Returns the name that a stream of the second source has in the comparison."
  @spec compared_name(String.t()) :: String.t()
  def compared_name(stream), do: @prefix <> stream

  @impl true
  def extent(%{first: first, second: second, offset: offset}) do
    with {:ok, a} <- Source.call(first, :extent, []),
         {:ok, b} <- Source.call(second, :extent, []) do
      {:ok,
       %{
         from: min(a.from, b.from + offset),
         to: max(a.to, b.to + offset),
         live: a.live or b.live,
         version: a.version + b.version
       }}
    end
  end

  @impl true
  def streams(%{first: first, second: second, offset: offset}) do
    with {:ok, a} <- Source.call(first, :streams, []),
         {:ok, b} <- Source.call(second, :streams, []) do
      beside =
        for info <- b do
          %{
            info
            | name: compared_name(info.name),
              first: add_offset(info.first, offset),
              last: add_offset(info.last, offset)
          }
        end

      {:ok, Enum.sort_by(Enum.reject(a, &compared_stream?(&1.name)) ++ beside, & &1.name)}
    end
  end

  defp add_offset(nil, _), do: nil
  defp add_offset(time, offset), do: time + offset

  @impl true
  def damage(%{first: first, second: second}),
    do:
      Source.list_damage(first) ++
        for(what <- Source.list_damage(second), do: @prefix <> " " <> what)

  @impl true
  def wanted(beside, streams) do
    for stream <- streams,
        do:
          with_stream(beside, stream, fn source, stream, _ ->
            Source.request_streams(source, [stream])
          end)
  end

  @impl true
  def series(beside, stream, from, to, bin) do
    with_stream(beside, stream, fn
      source, stream, 0 ->
        Source.call(source, :series, [stream, from, to, bin])

      source, stream, offset ->
        with {:ok, points, raw?} <-
               Source.call(source, :series, [stream, from - offset, to - offset, bin]),
             do: {:ok, for(p <- points, do: put_elem(p, 0, elem(p, 0) + offset)), raw?}
    end)
  end

  @impl true
  def messages(beside, stream, from, to, limit) do
    with_stream(beside, stream, fn source, stream, offset ->
      with {:ok, messages, more} <-
             Source.call(source, :messages, [stream, from - offset, to - offset, limit]),
           do: {:ok, Enum.map(messages, &shift_message(&1, offset)), more}
    end)
  end

  @impl true
  def marks(beside, stream, from, to, limit) do
    with_stream(beside, stream, fn source, stream, offset ->
      with {:ok, marks, more} <-
             Source.call(source, :marks, [stream, from - offset, to - offset, limit]),
           do: {:ok, for({time, latency} <- marks, do: {time + offset, latency}), more}
    end)
  end

  @impl true
  def sample(beside, stream, from, to, n) do
    with_stream(beside, stream, fn source, stream, offset ->
      with {:ok, rows} <- Source.sample_messages(source, stream, from - offset, to - offset, n),
           do: {:ok, for({i, message} <- rows, do: {i, shift_message(message, offset)})}
    end)
  end

  @impl true
  def summary(beside, stream, from, to, bins) do
    with_stream(beside, stream, fn source, stream, offset ->
      with {:ok, summary} <-
             Source.fetch_summary(source, stream, from - offset, to - offset, bins),
           do: {:ok, shift_summary(summary, offset)}
    end)
  end

  defp shift_summary(summary, 0), do: summary

  defp shift_summary(%{counts: counts, tracks: tracks} = summary, offset) do
    later = fn rows -> for row <- rows, do: put_elem(row, 0, elem(row, 0) + offset) end
    tracks = for {key, {kind, rows}} <- tracks, do: {key, {kind, later.(rows)}}
    %{summary | counts: later.(counts), tracks: tracks}
  end

  @impl true
  def latest_at(beside, stream, time), do: read_message(beside, :latest_at, stream, time)

  @impl true
  def next_after(beside, stream, time), do: read_message(beside, :next_after, stream, time)

  defp read_message(beside, function, stream, time) do
    with_stream(beside, stream, fn source, stream, offset ->
      with {:ok, message} <- Source.call(source, function, [stream, time - offset]),
           do: {:ok, shift_message(message, offset)}
    end)
  end

  defp with_stream(%{second: second, offset: offset}, @prefix <> stream, fun),
    do: fun.(second, stream, offset)

  defp with_stream(%{first: first}, stream, fun), do: fun.(first, stream, 0)

  defp shift_message(message, 0), do: message

  defp shift_message(%Message{} = m, offset) do
    %{
      m
      | originating_time: m.originating_time + offset,
        creation_time: add_offset(m.creation_time, offset),
        data: shift_data(m.data, offset)
    }
  end

  # Intervals are drawn at the times that they contain, so those are shifted as well.
  defp shift_data(%Interval{left: left, right: right} = interval, offset),
    do: %{interval | left: shift_bound(left, offset), right: shift_bound(right, offset)}

  defp shift_data(%Gap{} = hole, _offset), do: hole

  defp shift_data([head | tail], offset),
    do: [shift_data(head, offset) | shift_data(tail, offset)]

  defp shift_data({%Interval{} = interval, text}, offset),
    do: {shift_data(interval, offset), text}

  defp shift_data(%{interval: %Interval{} = interval} = map, offset),
    do: %{map | interval: shift_data(interval, offset)}

  defp shift_data(map, offset) when is_map(map) do
    case for(key <- @starts, is_integer(Map.get(map, key)), do: key) do
      [_, _ | _] = keys -> Enum.reduce(keys, map, &Map.update!(&2, &1, fn t -> t + offset end))
      _ when is_struct(map) -> map
      _ -> Map.new(map, fn {key, value} -> {key, shift_lane(value, offset)} end)
    end
  end

  defp shift_data(data, _offset), do: data

  # In a map of lanes, only intervals and lists of intervals are shifted.
  defp shift_lane(value, offset) when is_map(value) or is_list(value) or is_tuple(value),
    do: shift_data(value, offset)

  defp shift_lane(value, _offset), do: value

  defp shift_bound(x, offset) when is_number(x), do: x + offset
  defp shift_bound(unbounded, _offset), do: unbounded
end
