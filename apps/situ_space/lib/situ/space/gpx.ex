defmodule Situ.Space.Gpx do
  @moduledoc false
  # Opens GPX files as recordings (`Situ.Geo` documents the stream). GPX 1.0 and 1.1 are supported. Of two points with
  # the same time, the later one in the file is dropped. Files may have up to 200 MB.
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format

  alias Situ.{Error, GeoPoint, Message, Time, Xml}
  alias Situ.Space.GeometryFile.NumberParser
  alias Situ.Space.FileParser
  alias Situ.Store.StreamInfo

  @enforce_keys [:path, :points]
  defstruct [:path, :points, untimed: 0]

  @type t :: %__MODULE__{
          path: Path.t(),
          points: tuple(),
          untimed: non_neg_integer()
        }

  @most 200_000_000

  @impl true
  def extensions, do: [".gpx"]

  @impl true
  def kinds,
    do: [
      %Situ.Recording.FileKind{
        name: :gpx,
        title: "GPX track",
        extensions: extensions(),
        open: __MODULE__
      }
    ]

  @impl true
  def open(path, _opts) do
    with {:ok, points, untimed} <- FileParser.read_and_parse(path, @most, &parse/1),
         do: {:ok, %__MODULE__{path: path, points: List.to_tuple(points), untimed: untimed}}
  end

  @doc """
  Returns the points with their times (ns), and the number of points without a time. Errors: `:bad_gpx`.

      iex> xml = ~s(<gpx><trk><trkseg><trkpt lat="46.5" lon="14.5"><ele>300</ele>) <>
      ...>   ~s(<time>2026-01-31T12:00:00Z</time></trkpt></trkseg></trk></gpx>)
      iex> {:ok, [{time, point}], 0} = Situ.Space.Gpx.parse(xml)
      iex> {Situ.Time.to_iso8601(time), point.height}
      {"2026-01-31T12:00:00.000000000Z", 300.0}
  """
  @spec parse(binary()) ::
          {:ok, [{Time.t(), GeoPoint.t()}], non_neg_integer()} | {:error, Error.t()}
  def parse(bytes) do
    state = %{root?: false, point: nil, text: nil, points: [], untimed: 0}

    case Xml.reduce_events(bytes, state, &handle_event/2) do
      {:ok, %{root?: true} = state} ->
        points = state.points |> Enum.reverse() |> Enum.sort_by(&elem(&1, 0))
        {:ok, Enum.dedup_by(points, &elem(&1, 0)), state.untimed}

      {:ok, _} ->
        file_error("its first element is not gpx")

      {:error, why} ->
        file_error(why)
    end
  end

  defp file_error(what), do: {:error, Error.new(:bad_gpx, what, fix: "export the track again")}

  defp handle_event({:startElement, _, ~c"gpx", _, _}, state), do: %{state | root?: true}

  defp handle_event({:startElement, _, ~c"trkpt", _, attributes}, state) do
    given = for {_, _, name, value} <- attributes, into: %{}, do: {name, value}
    %{state | point: %{lat: parse_number(given[~c"lat"]), lon: parse_number(given[~c"lon"])}}
  end

  defp handle_event({:startElement, _, name, _, _}, %{point: %{}} = state)
       when name in [~c"ele", ~c"time", ~c"hdop"],
       do: %{state | text: []}

  defp handle_event({:characters, text}, %{text: parts} = state) when is_list(parts),
    do: %{state | text: [text | parts]}

  defp handle_event({:endElement, _, name, _}, %{text: parts, point: %{}} = state)
       when is_list(parts) and name in [~c"ele", ~c"time", ~c"hdop"] do
    text = parts |> Enum.reverse() |> Enum.concat()
    %{state | text: nil, point: Map.put(state.point, List.to_string(name), text)}
  end

  defp handle_event({:endElement, _, ~c"trkpt", _}, %{point: %{} = point} = state) do
    with time when is_list(time) <- point["time"],
         {:ok, time} <- parse_time(List.to_string(time)),
         {:ok, place} <- GeoPoint.new(point.lat, point.lon, height: parse_number(point["ele"])) do
      %{state | point: nil, points: [{time, place} | state.points]}
    else
      _ -> %{state | point: nil, untimed: state.untimed + 1}
    end
  end

  defp handle_event(_event, state), do: state

  defp parse_time(text) do
    case text |> String.trim() |> DateTime.from_iso8601() do
      {:ok, time, _} -> {:ok, DateTime.to_unix(time, :nanosecond)}
      {:error, _} -> :error
    end
  end

  defp parse_number(nil), do: nil

  defp parse_number(text) do
    case text |> List.to_string() |> String.trim() |> NumberParser.parse_float() do
      {:ok, x} -> x
      :error -> nil
    end
  end

  @impl true
  def info(gpx),
    do: %{
      name: recording_name(gpx),
      created: nil,
      closed?: true,
      live?: false,
      damage: [],
      untimed: gpx.untimed
    }

  defp recording_name(gpx), do: Path.basename(gpx.path, Path.extname(gpx.path))

  @impl true
  def streams(%{points: {}}), do: []

  def streams(%{points: points} = gpx) do
    count = tuple_size(points)
    {first, last} = {elem(elem(points, 0), 0), elem(elem(points, count - 1), 0)}

    [
      %StreamInfo{
        id: 1,
        name: "Track",
        store_name: recording_name(gpx),
        store_path: gpx.path,
        type: GeoPoint,
        type_name: inspect(GeoPoint),
        count: count,
        size: count * 32,
        stored: count * 32,
        opened: first,
        closed: last,
        first: first,
        last: last,
        first_creation: first
      }
    ]
  end

  @impl true
  def seek(gpx, _info, time), do: {:ok, search_index(gpx.points, time, 0, tuple_size(gpx.points))}

  # Finds the first point at or after a time by binary search.
  defp search_index(_points, _time, low, high) when low >= high, do: low

  defp search_index(points, time, low, high) do
    middle = div(low + high, 2)

    if elem(elem(points, middle), 0) < time,
      do: search_index(points, time, middle + 1, high),
      else: search_index(points, time, low, middle)
  end

  @impl true
  def read(gpx, info, ordinal, to, limit, _opts) do
    last = tuple_size(gpx.points) - 1

    messages =
      ordinal
      |> Stream.iterate(&(&1 + 1))
      |> Stream.take_while(&(&1 <= last and elem(elem(gpx.points, &1), 0) <= to))
      |> Stream.take(limit)
      |> Enum.map(&build_message(gpx.points, &1, info))

    {:ok, messages, ordinal + length(messages)}
  end

  defp build_message(points, i, info) do
    {time, place} = elem(points, i)

    %Message{
      data: place,
      originating_time: time,
      creation_time: time,
      sequence_id: i,
      source_id: info.id
    }
  end
end
