defmodule Situ.Bridge.Psi do
  @moduledoc """
  Opens recordings of Microsoft's *Platform for Situated Intelligence* (\\psi) like Situ's own. `Situ.Store.open/2`
  takes the folder (`lobby.0003`), the name of a store in a folder with several stores (`recordings/lobby`), or a name
  without a version for the newest version.

      {:ok, store} = Situ.Store.open("recordings/lobby.0003")
      Situ.Store.streams(store)
      {:ok, messages} = Situ.Store.read(store, "Head.Pose", from: t0, to: t1)

  Everything else that opens recordings works, too: `bin/situ store info`, the studio, replay in a pipeline,
  `situ store copy`.

  | .NET | here |
  |---|---|
  | numbers, `bool`, `string`, enums | integers, floats, booleans, strings, integers; NaN and infinities are `:nan`, `:infinity`, `:neg_infinity` |
  | `DateTime`, `TimeSpan` | nanoseconds (since 1970; of a duration) |
  | `char`, `decimal`, `Guid` | strings |
  | arrays, `List`, `IEnumerable`, `HashSet`, `SortedSet`, `LinkedList`, `Queue`, `Stack` (from the top); `byte[]`, `MemoryStream` | lists; binaries |
  | `Dictionary`, including sorted and concurrent ones; tuples; `Nullable`; `Shared<T>` | maps; tuples; the value or `nil`; the shared value |
  | images, depth images, encoded images (including depth, but without their scale, which is not in the file), audio | the same as Situ's |
  | `TimeIntervalAnnotationSet` | maps, which all functions for annotations accept |
  | classes and structs | maps with the names of the fields or properties, including private ones; `"$type"` is set if the declared type does not determine the type |

  Any object may be `nil`. Repeated references to an object become the same term; in a cycle they become
  `%{"$ref" => n}`, and the referenced object has the key `"$id"`. A message that cannot be decoded becomes a
  `Situ.Store.Undecoded` with its bytes and the reason.

  Opening a store scans its data once and keeps 28 bytes per message. All complete messages are available, even if the
  store was not closed, its writer was killed, or files are truncated or missing. `Situ.Store.info/1` lists lost data
  under `:damage`, and under `:notes` the streams whose types Situ knows only from the schemas in the store. A store
  that is being written is read in the state in which it was opened. Times, sequence numbers and stream ids are the
  recorded ones.
  """
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format
  alias Situ.{Error, Message}
  alias Situ.Bridge.Psi.{Bytes, Catalog, Decoder, Files, StoreScan, TypeName, TypePlans}
  alias Situ.Bridge.Psi.Catalog.Entry
  alias Situ.Bridge.Psi.StoreScan.Track
  alias Situ.Store.{StreamInfo, Undecoded}

  defstruct [:folder, :name, :catalog, :types, :tracks, :streams, :damage]

  # The maximum size of a batch, unless a single message is larger.
  @max_bytes 16 * 1024 * 1024

  @impl true
  def extensions, do: []

  @impl true
  def resolve(path) do
    case Files.find_store(path) do
      {:ok, folder, name} ->
        if Files.store_names(folder) == [name], do: folder, else: Path.join(folder, name)

      :error ->
        nil
    end
  end

  @impl true
  def list_recordings(folder) do
    case Files.store_names(folder) do
      [_only] -> [folder]
      names -> Enum.map(names, &Path.join(folder, &1))
    end
  end

  @impl true
  def open(path, _opts) do
    with {:ok, folder, name} <- find_store(path),
         {catalog, damage} = Catalog.read(folder, name),
         :ok <- check_catalog(catalog, folder, name) do
      {tracks, scan_damage} = StoreScan.scan_store(folder, name, catalog.streams)
      types = TypePlans.new(Map.values(catalog.schemas), Catalog.runtime_types(catalog))

      state = %__MODULE__{
        folder: folder,
        name: name,
        catalog: catalog,
        types: types,
        tracks: tracks
      }

      streams = for entry <- Map.values(catalog.streams), do: stream_info(state, entry)
      missing = Enum.flat_map(Map.values(catalog.streams), &report_missing(state, &1))
      damage = Enum.reverse(damage) ++ Enum.reverse(scan_damage) ++ missing
      {:ok, %{state | streams: Enum.sort_by(streams, & &1.id), damage: damage}}
    end
  end

  defp find_store(path) do
    with :error <- Files.find_store(path) do
      {:error,
       Error.new(:no_store, "no \\psi store at #{path}",
         why: "a file NAME.Catalog_000000.psi was not found",
         fix: "give the folder of a store, or folder/NAME if the folder has several stores"
       )}
    end
  end

  # Every catalog begins with the version of the runtime that wrote it.
  defp check_catalog(%{runtime: nil, streams: streams}, folder, name) when streams == %{} do
    {:error,
     Error.new(
       :not_psi,
       "#{Files.extent_path(folder, name, :catalog, 0)} is not a catalog of \\psi",
       why: "it contains no readable stream, type or version",
       fix: "check that the file is complete"
     )}
  end

  defp check_catalog(_catalog, _folder, _name), do: :ok

  defp stream_info(state, entry) do
    track = Map.get(state.tracks, entry.id, %Track{})

    %StreamInfo{
      id: entry.id,
      name: entry.name,
      store_name: state.name,
      store_path: state.folder,
      type: TypePlans.situ_type(state.types, entry.type_name),
      type_name: TypeName.short_name(entry.type_name),
      opened: entry.opened,
      closed: if(Entry.closed?(entry), do: entry.closed),
      count: track.count,
      size: if(entry.count == track.count and track.count > 0, do: entry.size, else: track.size),
      stored: track.size + 28 * track.count,
      latency_sum: track.latency,
      first: track.first,
      last: track.last,
      first_creation: track.first_creation,
      last_creation: track.last_creation,
      large?: Entry.indexed?(entry),
      supplemental: decode_supplemental(state.types, entry)
    }
  end

  defp decode_supplemental(_types, %{supplemental_type: nil}), do: nil

  defp decode_supplemental(types, entry) do
    handler = TypePlans.handler(types, entry.supplemental_type)

    case Decoder.decode(entry.supplemental, handler, types, rest: :any) do
      {:ok, value} ->
        {TypeName.short_name(entry.supplemental_type), :erlang.term_to_binary(value)}

      {:error, _} ->
        nil
    end
  end

  # The catalog entry of a closed stream contains its number of messages.
  defp report_missing(state, entry) do
    present = Map.get(state.tracks, entry.id, %Track{}).count

    if Entry.closed?(entry) and entry.count > present,
      do: [
        "#{entry.count - present} of #{entry.count} messages of the stream #{entry.name} are missing"
      ],
      else: []
  end

  @impl true
  def info(state) do
    %{
      name: state.name,
      created: state.streams |> Enum.map(& &1.opened) |> Enum.min(fn -> nil end),
      closed?: Enum.all?(state.streams, & &1.closed),
      live?: false,
      damage: state.damage,
      notes: Enum.flat_map(state.streams, &describe_type(&1, state)),
      written_by: state.catalog.runtime
    }
  end

  defp describe_type(%{type: :map, type_name: "System." <> _}, _state), do: []

  defp describe_type(%{type: type} = info, state)
       when type in [:map, :any, {:list, :map}, {:list, :any}] do
    explanation =
      case TypePlans.handler(state.types, state.catalog.streams[info.id].type_name) do
        {:object, nil} ->
          "no schema in the store describes it, unless its messages name their types"

        _ ->
          "its messages are maps, based on the schema in the store"
      end

    ["#{info.name} has the type #{info.type_name}: #{explanation}"]
  end

  defp describe_type(_info, _state), do: []

  @impl true
  def streams(state), do: state.streams

  @impl true
  def seek(state, info, time), do: {:ok, Track.seek(find_track(state, info), time)}

  defp find_track(state, %{id: id}), do: Map.get(state.tracks, id, %Track{})

  @impl true
  def read(state, info, ordinal, to, limit, opts) do
    track = find_track(state, info)
    last = min(last_ordinal(track, to), ordinal + limit - 1)

    case batch_positions(track, ordinal, last) do
      [] -> {:ok, [], ordinal}
      positions -> read_messages(state, info, positions, ordinal, opts)
    end
  end

  defp last_ordinal(track, :unbounded), do: track.count - 1
  defp last_ordinal(track, to), do: Track.seek(track, to + 1) - 1

  defp batch_positions(track, ordinal, last) do
    ordinal..last//1
    |> Enum.reduce_while({[], 0}, fn at, {positions, bytes} ->
      position = Track.position_at(track, at)
      bytes = bytes + position.length

      if positions != [] and bytes > @max_bytes,
        do: {:halt, {positions, bytes}},
        else: {:cont, {[position | positions], bytes}}
    end)
    |> elem(0)
    |> Enum.reverse()
  end

  defp read_messages(state, info, positions, ordinal, opts) do
    envelopes? = opts[:envelopes] == true
    type_name = state.catalog.streams[info.id].type_name
    handler = TypePlans.handler(state.types, type_name)

    with {:ok, blocks} <- read_blocks(state, positions, envelopes?) do
      decode = &Decoder.decode_message(&1, type_name, handler, state.types)
      messages = Enum.map(blocks, &decode_message(&1, decode, envelopes?))
      {:ok, messages, ordinal + length(messages)}
    end
  end

  defp decode_message(
         <<id::little-signed-32, seq::little-signed-32, time::little-64, created::little-64,
           data::binary>>,
         decode,
         envelopes?
       ) do
    %Message{
      data: if(envelopes?, do: nil, else: decode_data(data, decode)),
      originating_time: Bytes.parse_time(time),
      creation_time: Bytes.parse_time(created),
      sequence_id: seq,
      source_id: id
    }
  end

  defp decode_data(bytes, decode) do
    case decode.(bytes) do
      {:ok, value} -> value
      {:error, why} -> %Undecoded{codec: "psi", bytes: bytes, reason: why}
    end
  end

  # Neighboring messages are usually in the same file, which is opened once for all of them.
  defp read_blocks(state, positions, envelopes?) do
    positions
    |> Enum.chunk_by(&{&1.file, &1.extent})
    |> Enum.reduce_while({:ok, []}, fn [%{file: kind, extent: extent} | _] = chunk,
                                       {:ok, chunks} ->
      path = Files.extent_path(state.folder, state.name, kind, extent)

      case read_file_blocks(
             path,
             for(p <- chunk, do: {p.at, if(envelopes?, do: 24, else: p.length)})
           ) do
        {:ok, blocks} -> {:cont, {:ok, [blocks | chunks]}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
    |> case do
      {:ok, chunks} -> {:ok, chunks |> Enum.reverse() |> Enum.concat()}
      error -> error
    end
  end

  defp read_file_blocks(path, ranges) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]),
         result = :file.pread(file, ranges),
         :ok <- :file.close(file),
         {:ok, blocks} <- result,
         true <-
           Enum.all?(Enum.zip(ranges, blocks), fn {{_, n}, block} ->
             is_binary(block) and byte_size(block) == n
           end) do
      {:ok, blocks}
    else
      false ->
        {:error,
         Error.new(:damaged, "#{path} has changed since it was opened",
           fix: "open the store again"
         )}

      {:error, reason} ->
        {:error,
         Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))}
    end
  end
end
