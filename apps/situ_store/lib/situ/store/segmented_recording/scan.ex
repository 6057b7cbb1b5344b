defmodule Situ.Store.SegmentedRecording.Scan do
  @moduledoc false
  # Brings an index up to date with the folder: finds new segments, reads the statistics of segments that are
  # being written, and removes deleted segments.
  alias Situ.Store.{NativeFormat, Segments}
  alias Situ.Store.SegmentedRecording.{Contents, Timeline}
  alias Situ.Store.SegmentedRecording.Contents.Segment
  alias Situ.Store.SegmentedRecording.Timeline.Part

  @typedoc "The versions of a name in its folder, by number."
  @type folders :: [{integer(), Path.t()}]

  @doc """
  Returns the new contents, and the names of the streams whose parts have changed. With `dense?`, ordinals are
  assigned for the first time.
  """
  @spec update(Contents.t(), folders(), keyword(), boolean()) :: {Contents.t(), [String.t()]}
  def update(before, folders, opts, dense?) do
    contents = before |> remove_deleted(Map.new(folders)) |> open_new(Enum.reverse(folders), opts)
    written = Enum.flat_map(list_changing(contents), &list_written(contents, &1))
    contents = Enum.reduce(list_changing(contents), contents, &read_segment/2)
    changing = list_changing(contents)
    contents = Enum.reduce(changing, contents, &update_parts/2)

    ended =
      for {number, %{reader: nil}} <- contents.segments,
          not is_map_key(before.segments, number),
          do: number

    contents =
      add_parts(contents, written ++ Enum.flat_map(ended, &list_recorded(contents, &1)), dense?)

    complete = Enum.filter(changing, &complete?(contents, &1))
    contents = Enum.reduce(complete, contents, &release_reader/2)
    {contents, changed_streams(before, contents)}
  end

  defp list_changing(contents),
    do: for({number, %{reader: reader}} <- contents.segments, reader != nil, do: number)

  @doc "Returns how many versions have come and gone since the contents were read before."
  @spec count_unseen(Contents.t(), Contents.t(), folders()) :: non_neg_integer()
  def count_unseen(before, contents, folders) do
    known = before.segments |> Map.keys() |> Enum.max(fn -> nil end)
    newest = contents.segments |> Map.keys() |> Enum.max(fn -> nil end)

    if known == nil or newest == nil or newest <= known,
      do: 0,
      else: newest - known - Enum.count(folders, fn {n, _} -> n > known and n <= newest end)
  end

  @doc "Returns whether a new segment is older than a segment that was known before."
  @spec out_of_order?(Contents.t(), Contents.t()) :: boolean()
  def out_of_order?(before, contents) do
    known = before.segments |> Map.keys() |> Enum.max(fn -> nil end)

    known != nil and
      Enum.any?(contents.segments, fn {n, _} ->
        n < known and not is_map_key(before.segments, n)
      end)
  end

  defp changed_streams(before, contents) do
    for {name, timeline} <- contents.timelines, before.timelines[name] != timeline, do: name
  end

  defp remove_deleted(contents, folders) do
    gone = for {number, _} <- contents.segments, not is_map_key(folders, number), do: number

    unreadable =
      Map.filter(contents.unreadable, fn {key, _} ->
        is_binary(key) or is_map_key(folders, key)
      end)

    ignored = Map.filter(contents.ignored, fn {key, _} -> is_map_key(folders, key) end)
    contents = %{contents | unreadable: unreadable, ignored: ignored}
    Enum.reduce(gone, contents, &remove_segment/2)
  end

  # The files of a deleted segment can still be read through its reader. Its last messages have ordinals, too.
  defp remove_segment(number, contents) do
    contents =
      if contents.segments[number].reader, do: read_segment(number, contents), else: contents

    if is_map_key(contents.segments, number),
      do: drop_segment(number, update_parts(number, contents)),
      else: contents
  end

  defp drop_segment(number, contents) do
    {segment, segments} = Map.pop!(contents.segments, number)
    count = segment.infos |> Map.values() |> Enum.map(& &1.count) |> Enum.sum()
    {n, messages} = contents.deleted

    timelines =
      Map.new(contents.timelines, fn {name, timeline} ->
        {name, Timeline.remove_part(timeline, number)}
      end)

    %{contents | segments: segments, timelines: timelines, deleted: {n + 1, messages + count}}
  end

  defp open_new(contents, folders, opts) do
    for {number, path} <- folders,
        not is_map_key(contents.segments, number),
        contents.ignored[number] != index_stamp(path),
        reduce: contents,
        do: (contents -> open_version(contents, {number, path}, opts))
  end

  defp open_version(contents, {number, path}, opts) do
    with {:ok, reader} <- NativeFormat.open(path, opts),
         %{} = info <- NativeFormat.info(reader) do
      contents = %{contents | unreadable: Map.delete(contents.unreadable, number)}
      stamp = index_stamp(path)

      cond do
        info.piece != nil ->
          add_segment(contents, %Segment{
            number: number,
            path: path,
            run: info.piece.run,
            info: info,
            reader: reader,
            stamp: stamp
          })

        # The mark is the second record of a segment.
        info.live? and info.entries < 2 ->
          contents

        true ->
          put_in(contents.ignored[number], stamp)
      end
    else
      {:error, error} -> note_unreadable(contents, number, path, error)
    end
  rescue
    error in Situ.Error -> note_unreadable(contents, number, path, error)
  end

  # A recording may have more segments that have ended than a process may open files, so these are read one by one.
  defp add_segment(contents, %{number: number, info: %{live?: live?}} = segment) do
    contents = put_in(contents.segments[number], segment)
    if live?, do: contents, else: release_reader(number, read_segment(number, contents))
  end

  # The index of a segment was damaged after it was opened.
  defp read_segment(number, contents) do
    read_state(number, contents)
  rescue
    error in Situ.Error ->
      path = contents.segments[number].path
      note_unreadable(drop_segment(number, contents), number, path, error)
  end

  # A recorder that was killed may leave a folder without content.
  defp note_unreadable(contents, number, path, error) do
    if Segments.nothing_written?(path),
      do: contents,
      else:
        put_in(
          contents.unreadable[number],
          "#{Path.basename(path)} cannot be read: #{error.what}"
        )
  end

  # The fields of an index header up to the state; see `priv/schema/store.md`. A repair within a second of the last
  # change leaves the size and the modification time as they were, but not the header.
  @header_bytes 84

  @doc "Returns a value that changes if the index file of a store that is not being written is changed or replaced."
  @spec index_stamp(Path.t()) :: term()
  def index_stamp(path) do
    index = Path.join(path, "index.situ")

    with {:ok, info} <- :file.read_file_info(index, [:raw, time: :posix]),
         {:ok, file} <- :file.open(index, [:read, :raw, :binary]) do
      header = :file.read(file, @header_bytes)
      _ = :file.close(file)
      {elem(info, 11), elem(info, 1), elem(info, 5), header}
    else
      {:error, _} -> nil
    end
  end

  @doc "Reads a segment again whose files were replaced. Its ordinals stay as they were."
  @spec reload(Contents.t(), integer(), keyword()) :: {Contents.t(), [String.t()]}
  def reload(contents, number, opts) do
    segment = contents.segments[number]

    case NativeFormat.open(segment.path, opts) do
      {:ok, reader} ->
        segment = %{segment | reader: reader, stamp: index_stamp(segment.path)}
        after_reading = read_segment(number, put_in(contents.segments[number], segment))
        reloaded = finish_reload(number, after_reading)
        {reloaded, changed_streams(contents, reloaded)}

      {:error, error} ->
        reloaded = note_unreadable(drop_segment(number, contents), number, segment.path, error)
        {reloaded, changed_streams(contents, reloaded)}
    end
  end

  defp finish_reload(number, contents) do
    if is_map_key(contents.segments, number),
      do: release_reader(number, update_parts(number, contents)),
      else: contents
  end

  # A stream writes to one segment after another. The counts of all segments are read after it is known which segments
  # the stream has reached, so the count of every segment but its last is final.
  defp list_written(contents, number) do
    segment = contents.segments[number]
    for info <- NativeFormat.streams(segment.reader), info.first != nil, do: {number, info.id}
  end

  defp list_recorded(contents, number) do
    for {_, info} <- contents.segments[number].infos, info.first != nil, do: {number, info.id}
  end

  defp read_state(number, contents) do
    segment = contents.segments[number]
    # The state is read before the streams: after the end, nothing follows.
    info = NativeFormat.info(segment.reader)
    streams = NativeFormat.streams(segment.reader)
    contents = Enum.reduce(streams, contents, &name_stream/2)
    infos = Map.new(streams, &{contents.names[{&1.name, &1.type_name}], &1})
    put_in(contents.segments[number], %{segment | info: info, infos: infos})
  end

  # Streams of the same name and different types are different streams. The newest has the plain name, unless another
  # one has been read under that name.
  defp name_stream(%{name: name, type_name: type, id: id}, contents) do
    if is_map_key(contents.names, {name, type}) do
      contents
    else
      shown = if is_map_key(contents.ids, name), do: "#{name} (#{type})", else: name
      used = Map.values(contents.ids)
      id = if id in used, do: Enum.max(used) + 1, else: id

      %{
        contents
        | names: Map.put(contents.names, {name, type}, shown),
          ids: Map.put_new(contents.ids, shown, id)
      }
    end
  end

  defp update_parts(number, contents) do
    for {name, %{first: first} = info} <- contents.segments[number].infos,
        first != nil,
        timeline = contents.timelines[name],
        timeline != nil,
        reduce: contents do
      contents ->
        part = build_part(contents.segments[number], info)
        put_in(contents.timelines[name], Timeline.update_part(timeline, part))
    end
  end

  defp build_part(segment, info) do
    %Part{
      number: segment.number,
      run: segment.run,
      id: info.id,
      count: info.count,
      first: info.first,
      last: info.last
    }
  end

  defp add_parts(contents, written, dense?) do
    new =
      for {number, id} <- written,
          segment = contents.segments[number],
          segment != nil,
          {name, %{id: ^id} = info} <- segment.infos,
          not has_part?(contents.timelines[name], number),
          do: {name, build_part(segment, info)}

    new
    |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
    |> Enum.reduce(contents, fn {name, parts}, contents ->
      timeline = contents.timelines[name] || %Timeline{}
      count = &count_before(contents, name, &1, &2)

      timeline =
        Enum.reduce(order_parts(parts), timeline, &Timeline.add_part(&2, &1, count, dense?))

      put_in(contents.timelines[name], timeline)
    end)
  end

  defp has_part?(nil, _number), do: false
  defp has_part?(timeline, number), do: Timeline.known_part?(timeline, number)

  # Runs follow one another in the order of their first segments; within a run, the times decide.
  defp order_parts(parts) do
    parts
    |> separate_unmarked()
    |> Enum.group_by(& &1.run)
    |> Enum.sort_by(fn {_, parts} -> parts |> Enum.map(& &1.number) |> Enum.min() end)
    |> Enum.flat_map(fn {_, parts} -> Enum.sort_by(parts, & &1.first) end)
  end

  # Segments of earlier releases are not marked with a run. If they overlap, each is treated as a run.
  defp separate_unmarked(parts) do
    {unmarked, marked} = Enum.split_with(parts, &(&1.run == nil))
    sorted = Enum.sort_by(unmarked, & &1.first)

    overlap? =
      sorted
      |> Enum.chunk_every(2, 1, :discard)
      |> Enum.any?(fn [a, b] -> b.first <= a.last end)

    if overlap?, do: marked ++ for(p <- unmarked, do: %{p | run: p.number}), else: parts
  end

  defp count_before(contents, name, part, time) do
    segment = contents.segments[part.number]

    with {:ok, reader} <- open_reader(segment),
         {:ok, ordinal} <- NativeFormat.seek(reader, segment.infos[name], time),
         do: min(ordinal, part.count),
         else: (_ -> part.count)
  end

  defp open_reader(%{reader: nil, path: path}), do: NativeFormat.open(path, [])
  defp open_reader(%{reader: reader}), do: {:ok, reader}

  # Streams may have begun while the segments were read.
  defp complete?(contents, number) do
    Enum.all?(contents.segments[number].infos, fn {name, info} ->
      info.first == nil or has_part?(contents.timelines[name], number)
    end)
  end

  # A segment that has ended does not change, so it is opened again when it is read.
  defp release_reader(number, contents) do
    segment = contents.segments[number]

    if segment == nil or segment.info.live? do
      contents
    else
      name = Path.basename(segment.path)
      missing = for file <- NativeFormat.missing_files(segment.reader), do: Path.join(name, file)
      stamp = index_stamp(segment.path)
      released = %{segment | reader: nil, missing: missing, stamp: stamp}
      put_in(contents.segments[number], released)
    end
  end
end
