defmodule Situ.Store.SegmentedRecording.Contents do
  @moduledoc false
  # The contents of an index: the segments of a recording, and the timeline of every stream. Pure.
  alias Situ.Store.SegmentedRecording.Timeline
  alias Situ.Store.StreamInfo

  defmodule Segment do
    @moduledoc false
    # One segment. `infos` are its streams by their names in the recording. `reader` is `nil` for a segment that will
    # not change. `stamp` changes if its files are replaced.
    @enforce_keys [:number, :path, :run, :info, :reader, :stamp]
    defstruct [:number, :path, :run, :info, :reader, :stamp, infos: %{}, missing: []]
    @type t :: %__MODULE__{}
  end

  # `names`: the name of a stream in the recording, by its name and type in the segments. `ignored`: versions that are
  # not segments. `unreadable`: versions that cannot be opened, with the reason.
  defstruct segments: %{},
            timelines: %{},
            names: %{},
            ids: %{},
            ignored: %{},
            unreadable: %{},
            deleted: {0, 0}

  @type t :: %__MODULE__{}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Returns whether all versions are known and none of them can change."
  @spec unchanging?(t(), [{integer(), Path.t()}]) :: boolean()
  def unchanging?(contents, folders) do
    contents.unreadable == %{} and
      Enum.all?(contents.segments, fn {_, segment} -> segment.reader == nil end) and
      map_size(contents.segments) + map_size(contents.ignored) >= length(folders)
  end

  @doc "Notes the segments that have lost their names, because their compaction was interrupted."
  @spec note_lost(t(), [Path.t()]) :: t()
  def note_lost(contents, folders) do
    lost = for folder <- folders, into: %{}, do: {folder, lost_sentence(folder)}
    unreadable = Map.filter(contents.unreadable, fn {key, _} -> is_integer(key) end)
    %{contents | unreadable: Map.merge(unreadable, lost)}
  end

  defp lost_sentence(folder),
    do: "#{Path.basename(folder)} has lost its name; `situ store repair` restores it"

  @doc "Returns the segments, oldest first."
  @spec list_segments(t()) :: [Segment.t()]
  def list_segments(contents),
    do: contents.segments |> Map.values() |> Enum.sort_by(& &1.number)

  @doc "Returns the number of the oldest segment, or -1."
  @spec first_number(t()) :: integer()
  def first_number(contents), do: contents.segments |> Map.keys() |> Enum.min(fn -> -1 end)

  @spec fetch_segment(t(), integer()) :: Segment.t() | nil
  def fetch_segment(contents, number), do: contents.segments[number]

  @doc "Returns the readers of the segments that are being written, by number."
  @spec live_readers(t()) :: [{integer(), struct()}]
  def live_readers(contents),
    do:
      for(
        {number, %{info: %{live?: true}, reader: reader}} <- contents.segments,
        do: {number, reader}
      )

  @doc "Returns the first ordinal of every stream whose first messages were deleted."
  @spec first_ordinals(t()) :: %{String.t() => pos_integer()}
  def first_ordinals(contents) do
    for {name, timeline} <- contents.timelines,
        first = first_ordinal(timeline),
        first > 0,
        into: %{},
        do: {name, first}
  end

  defp first_ordinal(%{parts: []} = timeline), do: Timeline.next_ordinal(timeline)
  defp first_ordinal(%{parts: parts}), do: List.last(parts).base

  @doc "Returns the ordinal after the last message of a stream."
  @spec next_ordinal(t(), String.t()) :: non_neg_integer()
  def next_ordinal(contents, name) do
    case contents.timelines do
      %{^name => timeline} -> Timeline.next_ordinal(timeline)
      _ -> 0
    end
  end

  @doc "Returns the parts of a stream in order of time."
  @spec parts_of(t(), String.t()) :: tuple()
  def parts_of(contents, name) do
    case contents.timelines do
      %{^name => %{parts: parts}} -> parts |> Enum.reverse() |> List.to_tuple()
      _ -> {}
    end
  end

  @doc "Returns the number of messages that a later run of the recorder hides."
  @spec count_hidden(t()) :: non_neg_integer()
  def count_hidden(contents),
    do: contents.timelines |> Map.values() |> Enum.map(& &1.hidden) |> Enum.sum()

  @doc "Returns all streams of the recording, in the order in which they were first recorded."
  @spec list_streams(t(), Path.t()) :: [StreamInfo.t()]
  def list_streams(contents, path) do
    for {name, _id} <- Enum.sort_by(contents.ids, &elem(&1, 1)),
        info = build_stream(contents, name, path),
        info != nil,
        do: info
  end

  @doc "Returns a stream of the recording, or `nil`."
  @spec build_stream(t(), String.t(), Path.t()) :: StreamInfo.t() | nil
  def build_stream(contents, name, path) do
    infos = for %{infos: %{^name => info}} <- list_segments(contents), do: info
    if infos != [], do: combine_infos(infos, contents, name, path)
  end

  defp combine_infos(infos, contents, name, path) do
    newest = List.last(infos)
    written = Enum.filter(infos, & &1.first)
    parts = (contents.timelines[name] || %Timeline{}).parts
    live? = live_readers(contents) != []

    %{
      newest
      | id: contents.ids[name],
        name: name,
        store_name: Path.basename(path),
        store_path: path,
        opened: infos |> Enum.map(& &1.opened) |> Enum.min(),
        closed: if(not live?, do: closing_time(parts, contents, name, newest)),
        first: if(parts != [], do: List.last(parts).first),
        last: if(parts != [], do: hd(parts).last),
        first_creation: find_limit(written, :first_creation, &Enum.min/1),
        last_creation: find_limit(written, :last_creation, &Enum.max/1),
        module: find_latest(infos, :module),
        fields: find_latest(infos, :fields),
        supplemental: find_latest(infos, :supplemental),
        count: parts |> Enum.map(& &1.count) |> Enum.sum(),
        size: sum_field(infos, :size),
        stored: sum_field(infos, :stored),
        latency_sum: sum_field(infos, :latency_sum)
    }
  end

  # A recorder closes a stream in the last segment only.
  defp closing_time([], _contents, _name, newest), do: newest.closed

  defp closing_time([%{number: number} | _], contents, name, newest),
    do: newest.closed || contents.segments[number].infos[name].closed

  defp find_latest(infos, key),
    do: infos |> Enum.reverse() |> Enum.find_value(&Map.fetch!(&1, key))

  defp sum_field(infos, key), do: infos |> Enum.map(&Map.fetch!(&1, key)) |> Enum.sum()

  defp find_limit(infos, key, limit) do
    case for(info <- infos, time = Map.fetch!(info, key), do: time) do
      [] -> nil
      times -> limit.(times)
    end
  end
end
