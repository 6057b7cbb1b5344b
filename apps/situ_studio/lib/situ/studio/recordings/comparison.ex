defmodule Situ.Studio.Recordings.Comparison do
  @moduledoc false
  # Combines two recordings on one time axis. The names of the second recording's streams begin
  # with `Compared.`, and all their times are shifted by an offset, including the times of
  # intervals inside messages. Streams of the first recording with such a name are hidden.
  @behaviour Situ.Recording

  alias Situ.{Interval, Message, Recording, Store}
  alias Situ.Studio.Draw.Bins
  alias Situ.Studio.{Gap, StreamReader}
  alias Situ.Studio.Recordings.Origin

  @prefix "Compared."
  @starts [:start, :stop, :end, "start", "stop", "end"]

  @enforce_keys [:first, :second, :offset]
  defstruct [:first, :second, :offset]

  @type t :: %__MODULE__{
          first: Recording.t(),
          second: Recording.t(),
          offset: Situ.Time.duration()
        }

  @doc """
  Combines two recordings and shifts the second by `offset` ns.

      iex> alias Situ.Studio.{History, Recordings, StreamReader}
      iex> [first, second] = for _ <- 1..2, do: History.new(live: false)
      iex> :ok = History.put(second, "Level", %Situ.Message{data: 20, originating_time: 5}, 8)
      iex> [first, second] = for history <- [first, second], do: Recordings.History.wrap(history)
      iex> both = Recordings.Comparison.combine_recordings(first, second, 100)
      iex> {:ok, message} = StreamReader.latest_at(both, "Compared.Level", 200)
      iex> {message.originating_time, message.data}
      {105, 20}
  """
  @spec combine_recordings(Recording.t(), Recording.t(), Situ.Time.duration()) :: Recording.t()
  def combine_recordings(first, second, offset) do
    state = %__MODULE__{first: first, second: second, offset: offset}
    %Recording{module: __MODULE__, state: state}
  end

  @doc """
  Returns whether a stream belongs to the second recording.

      iex> Enum.map(["Compared.Level", "Level"], &Situ.Studio.Recordings.Comparison.compared_stream?/1)
      [true, false]
  """
  @spec compared_stream?(String.t()) :: boolean()
  def compared_stream?(name), do: String.starts_with?(name, @prefix)

  @doc "Returns the name that a stream of the second recording has in the comparison."
  @spec compared_name(String.t()) :: String.t()
  def compared_name(stream), do: @prefix <> stream

  @impl true
  def info(%{first: first, second: second}) do
    {a, b} = {Store.info(first), Store.info(second)}
    damage = for what <- StreamReader.list_damage(second), do: "#{@prefix} #{what}"

    %{
      a
      | closed?: a.closed? and b.closed?,
        live?: a.live? or b.live?,
        damage: StreamReader.list_damage(first) ++ damage
    }
  end

  @impl true
  def streams(%{first: first, second: second, offset: offset}) do
    own =
      for info <- Store.streams(first),
          not compared_stream?(info.name),
          do: put_offset(info, first, 0)

    compared =
      for info <- Store.streams(second),
          do: %{put_offset(info, second, offset) | name: compared_name(info.name)}

    own ++ compared
  end

  @impl true
  def stream(%{second: second, offset: offset}, @prefix <> stream = name) do
    with {:ok, info} <- Store.stream_info(second, stream),
         do: {:ok, %{put_offset(info, second, offset) | name: name}}
  end

  def stream(%{first: first}, name) do
    with {:ok, info} <- Store.stream_info(first, name), do: {:ok, put_offset(info, first, 0)}
  end

  defp put_offset(info, recording, offset) do
    shifted = Origin.put_origin(info, recording)

    %{
      shifted
      | first: add_offset(info.first, offset),
        last: add_offset(info.last, offset),
        extra: Map.put(shifted.extra, :offset, offset)
    }
  end

  defp add_offset(nil, _), do: nil
  defp add_offset(:unbounded, _), do: :unbounded
  defp add_offset(time, offset), do: time + offset

  @impl true
  def request_streams(%{first: first, second: second}, names) do
    {compared, own} = Enum.split_with(names, &compared_stream?/1)
    StreamReader.request_streams(first, own)
    names = for name <- compared, do: String.replace_prefix(name, @prefix, "")
    StreamReader.request_streams(second, names)
  end

  @impl true
  def seek(_comparison, info, time), do: Origin.seek(info, time - info.extra.offset)

  @impl true
  def read(_comparison, %{extra: %{offset: offset}} = info, ordinal, to, limit, opts) do
    with {:ok, messages, next} <-
           Origin.read(info, ordinal, add_offset(to, -offset), limit, opts),
         do: {:ok, Enum.map(messages, &shift_message(&1, offset)), next}
  end

  @impl true
  def summary(_comparison, %{extra: %{offset: offset}} = info, from, to, pixels) do
    with {:ok, width, rows} <- Origin.summary(info, from - offset, to - offset, pixels),
         do: {:ok, width, Bins.shift_points(rows, offset)}
  end

  @impl true
  def tracks(_comparison, %{extra: %{offset: offset}} = info, from, to, level, most) do
    with {:ok, counts, tracks} <- Origin.tracks(info, from - offset, to - offset, level, most) do
      tracks =
        for {key, {kind, rows}} <- tracks, do: {key, {kind, Bins.shift_points(rows, offset)}}

      {:ok, Bins.shift_points(counts, offset), tracks}
    end
  end

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

  defp shift_data(%Gap{} = gap, _offset), do: gap

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
