defmodule Situ.Studio.Source.Beside do
  @moduledoc """
  Combines two sources on one time axis. The names of the second source's streams begin with `Compared.`, and all their
  times are shifted by an offset, including the times of intervals inside messages. Streams of the first source with
  such a name are hidden.

      iex> [first, second] = for _ <- 1..2, do: Situ.Studio.History.new(live: false)
      iex> :ok = Situ.Studio.History.put(second, "Level", %Situ.Message{data: 20, originating_time: 5}, 8)
      iex> [first, second] = for history <- [first, second], do: {Situ.Studio.Source.History, history}
      iex> source = Situ.Studio.Source.Beside.of(first, second, 100)
      iex> {:ok, message} = Situ.Studio.Source.call(source, :latest_at, ["Compared.Level", 200])
      iex> {message.originating_time, message.data}
      {105, 20}
  """
  @behaviour Situ.Studio.Source

  alias Situ.{Interval, Message}
  alias Situ.Studio.{Hole, Source}

  @prefix "Compared."
  @starts [:start, :stop, :end, "start", "stop", "end"]

  @enforce_keys [:first, :second, :offset]
  defstruct [:first, :second, :offset]

  @type t :: %__MODULE__{first: Source.t(), second: Source.t(), offset: Situ.Time.duration()}

  @doc "Combines two sources and shifts the second by `offset` ns."
  @spec of(Source.t(), Source.t(), Situ.Time.duration()) :: Source.t()
  def of(first, second, offset),
    do: {__MODULE__, %__MODULE__{first: first, second: second, offset: offset}}

  @doc """
  Returns whether a stream belongs to the second source.

      iex> Enum.map(["Compared.Level", "Level"], &Situ.Studio.Source.Beside.second?/1)
      [true, false]
  """
  @spec second?(String.t()) :: boolean()
  def second?(name), do: String.starts_with?(name, @prefix)

  @doc "Returns the name that a stream of the second source has in the comparison."
  @spec name(String.t()) :: String.t()
  def name(stream), do: @prefix <> stream

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
            | name: name(info.name),
              first: plus(info.first, offset),
              last: plus(info.last, offset)
          }
        end

      {:ok, Enum.sort_by(Enum.reject(a, &second?(&1.name)) ++ beside, & &1.name)}
    end
  end

  defp plus(nil, _), do: nil
  defp plus(time, offset), do: time + offset

  @impl true
  def damage(%{first: first, second: second}),
    do: Source.damage(first) ++ for(what <- Source.damage(second), do: @prefix <> " " <> what)

  @impl true
  def wanted(beside, streams) do
    for stream <- streams,
        do: ask(beside, stream, fn source, stream, _ -> Source.wanted(source, [stream]) end)
  end

  @impl true
  def series(beside, stream, from, to, bin) do
    ask(beside, stream, fn
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
    ask(beside, stream, fn source, stream, offset ->
      with {:ok, messages, more} <-
             Source.call(source, :messages, [stream, from - offset, to - offset, limit]),
           do: {:ok, Enum.map(messages, &shift(&1, offset)), more}
    end)
  end

  @impl true
  def marks(beside, stream, from, to, limit) do
    ask(beside, stream, fn source, stream, offset ->
      with {:ok, marks, more} <-
             Source.call(source, :marks, [stream, from - offset, to - offset, limit]),
           do: {:ok, for({time, latency} <- marks, do: {time + offset, latency}), more}
    end)
  end

  @impl true
  def sample(beside, stream, from, to, n) do
    ask(beside, stream, fn source, stream, offset ->
      with {:ok, rows} <- Source.sample(source, stream, from - offset, to - offset, n),
           do: {:ok, for({i, message} <- rows, do: {i, shift(message, offset)})}
    end)
  end

  @impl true
  def summary(beside, stream, from, to, bins) do
    ask(beside, stream, fn source, stream, offset ->
      with {:ok, summary} <- Source.summary(source, stream, from - offset, to - offset, bins),
           do: {:ok, summarised(summary, offset)}
    end)
  end

  defp summarised(summary, 0), do: summary

  defp summarised(%{counts: counts, tracks: tracks} = summary, offset) do
    later = fn rows -> for row <- rows, do: put_elem(row, 0, elem(row, 0) + offset) end
    tracks = for {key, {kind, rows}} <- tracks, do: {key, {kind, later.(rows)}}
    %{summary | counts: later.(counts), tracks: tracks}
  end

  @impl true
  def latest_at(beside, stream, time), do: one(beside, :latest_at, stream, time)

  @impl true
  def next_after(beside, stream, time), do: one(beside, :next_after, stream, time)

  defp one(beside, function, stream, time) do
    ask(beside, stream, fn source, stream, offset ->
      with {:ok, message} <- Source.call(source, function, [stream, time - offset]),
           do: {:ok, shift(message, offset)}
    end)
  end

  defp ask(%{second: second, offset: offset}, @prefix <> stream, fun),
    do: fun.(second, stream, offset)

  defp ask(%{first: first}, stream, fun), do: fun.(first, stream, 0)

  defp shift(message, 0), do: message

  defp shift(%Message{} = m, offset) do
    %{
      m
      | originating_time: m.originating_time + offset,
        creation_time: plus(m.creation_time, offset),
        data: within(m.data, offset)
    }
  end

  # Intervals are drawn at the times that they contain, so those are shifted as well.
  defp within(%Interval{left: left, right: right} = interval, offset),
    do: %{interval | left: bound(left, offset), right: bound(right, offset)}

  defp within(%Hole{} = hole, _offset), do: hole
  defp within([head | tail], offset), do: [within(head, offset) | within(tail, offset)]

  defp within({%Interval{} = interval, text}, offset), do: {within(interval, offset), text}

  defp within(%{interval: %Interval{} = interval} = map, offset),
    do: %{map | interval: within(interval, offset)}

  defp within(map, offset) when is_map(map) do
    case for(key <- @starts, is_integer(Map.get(map, key)), do: key) do
      [_, _ | _] = keys -> Enum.reduce(keys, map, &Map.update!(&2, &1, fn t -> t + offset end))
      _ when is_struct(map) -> map
      _ -> Map.new(map, fn {key, value} -> {key, lane(value, offset)} end)
    end
  end

  defp within(data, _offset), do: data

  # In a map of lanes, only intervals and lists of intervals are shifted.
  defp lane(value, offset) when is_map(value) or is_list(value) or is_tuple(value),
    do: within(value, offset)

  defp lane(value, _offset), do: value

  defp bound(x, offset) when is_number(x), do: x + offset
  defp bound(unbounded, _offset), do: unbounded
end
