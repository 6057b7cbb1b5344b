defmodule Situ.Store.Copying do
  @moduledoc false
  # Copies, crops and concatenates stores. Called through `Situ.Store`. Envelopes, types,
  # metadata, codecs and payloads are copied unchanged, even if this system has no module for
  # them. The originals are only read.
  #
  # A new store gets its name when it is complete. A program that is killed halfway leaves a
  # folder `NAME.*.unfinished`, which the next program to create a store of this name deletes.
  alias Situ.Error
  alias Situ.Store.Copying.Passes
  alias Situ.Recording.Formats

  alias Situ.Store.{
    Draft,
    NativeErrors,
    NativeFormat,
    Folder,
    Query,
    SegmentedRecording,
    Segments,
    StreamInfo,
    Transfer,
    Writer
  }

  @options [
    from: [type: {:optional, :integer}, doc: "The first originating time."],
    to: [type: {:optional, :integer}, doc: "The last originating time (inclusive)."],
    streams: [
      type: {:or, [{:list, :string}, {:fun, 1}]},
      doc: "Names, patterns like `\"Room.*\"`, or a predicate of `Situ.Store.StreamInfo`."
    ],
    compression: [
      type: {:in, [:none, :lz4, :zstd]},
      doc: "The compression of all streams. Default: as in the original."
    ],
    skip_damage: [type: :boolean, default: true, doc: "Skip damaged chunks."],
    progress: [type: {:fun, 2}, doc: "Called as `fun.(done, total)` with message counts."],
    times: [
      type: {:in, [:header, :record]},
      default: :header,
      doc:
        "For bags and MCAP files: take originating times from the message headers (`:header`), if there are any, or " <>
          "from the times of recording (`:record`)."
    ],
    empty: [
      type: {:in, [:allow, :refuse]},
      default: :allow,
      doc:
        "For an interval without messages, create a store without messages or return the error `:empty_interval`."
    ],
    versioned: [type: :boolean, default: true, doc: "Create a subfolder `NAME.NNNN`."],
    durability: [
      type: :any,
      default: :none,
      doc:
        "Durability during writing, as in `Situ.Store.Writer.create/3`. The finished store is always synced to disk."
    ]
  ]
  @interval_options [
    start: [
      type: :integer,
      doc: "Start in ns after the store's first message, instead of `from:`."
    ],
    length: [type: :non_neg_integer, doc: "Length in ns, instead of `to:`."]
  ]
  @spec copy_options() :: Situ.Options.schema()
  def copy_options, do: @options

  @spec interval_options() :: Situ.Options.schema()
  def interval_options, do: @interval_options

  @spec copy(Path.t(), Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def copy(from, to, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @options),
         {:ok, store} <- open_source(from, opts[:times]),
         :ok <- check_damage([store], opts),
         {:ok, sources} <- select_streams(list_sources(store), opts[:streams], store.path),
         :ok <- check_interval(sources, opts) do
      build_store(to, Enum.map(sources, fn {_, info} = source -> {info, [source]} end), opts)
    end
  end

  @earliest -0x8000000000000000
  @latest 0x7FFFFFFFFFFFFFFF

  @spec crop(Path.t(), Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def crop(from, to, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @options ++ @interval_options),
         {:ok, store} <- open_source(from, opts[:times]) do
      {first, _last} = Query.interval(store) || {0, 0}
      start = opts[:from] || first + (opts[:start] || 0)
      stop = opts[:to] || (opts[:length] && start + opts[:length])

      if stop && stop < start do
        {:error, Error.new(:bad_interval, "the interval ends before it starts")}
      else
        copy(
          from,
          to,
          opts |> Keyword.drop([:start, :length]) |> Keyword.merge(from: start, to: stop)
        )
      end
    end
  end

  @spec concat([Path.t()], Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def concat(paths, to, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @options),
         {:ok, stores} <- open_all(paths, opts[:times]),
         :ok <- check_damage(stores, opts),
         where = Enum.map_join(stores, ", ", & &1.path),
         {:ok, named} <-
           select_streams(Enum.flat_map(stores, &list_sources/1), opts[:streams], where),
         names = named |> Enum.map(fn {_, info} -> info.name end) |> Enum.uniq(),
         parts =
           for(
             name <- names,
             do: order_by_time(Enum.filter(named, fn {_, info} -> info.name == name end))
           ),
         :ok <- check_compatible(parts),
         :ok <- check_interval(named, opts) do
      build_store(to, parts, opts)
    end
  end

  # Reading a damaged chunk of a store is an error. Files of other programs list their damage when they are opened, and
  # readers omit it.
  defp check_damage(stores, opts) do
    damaged =
      for store <- stores, opts[:skip_damage] == false, [first | more] <- [list_damage(store)] do
        why = Situ.Recording.describe_damage(first)
        if more == [], do: why, else: "#{why}; and #{length(more)} more"
      end

    case damaged do
      [] -> :ok
      [why | _] -> {:error, damaged_error(why)}
    end
  end

  defp list_damage(%{module: module}) when module in [NativeFormat, SegmentedRecording], do: []
  defp list_damage(store), do: Query.info(store).damage || []

  defp damaged_error(why) do
    Error.new(:damaged, "the file is damaged, and nothing was copied",
      why: why,
      fix: "pass skip_damage: true (--skip-damage) to copy everything else"
    )
  end

  # An interval without messages is probably a mistake in the times.
  defp check_interval(sources, opts) do
    wanted = {opts[:from] || @earliest, opts[:to] || @latest}
    infos = for {_, info} <- sources, info.count > 0, do: info

    cond do
      opts[:empty] == :allow -> :ok
      opts[:from] == nil and opts[:to] == nil -> :ok
      infos == [] -> :ok
      Enum.any?(sources, &any_within?(&1, wanted)) -> :ok
      true -> {:error, empty_interval(infos, wanted)}
    end
  end

  defp any_within?({_, %{count: 0}}, _wanted), do: false

  defp any_within?({store, info}, {from, to}) do
    case Query.first_at(store, info, from) do
      {:ok, nil} -> false
      {:ok, message} -> message.originating_time <= to
      # The copy reports the damage.
      {:error, _} -> true
    end
  end

  defp empty_interval(infos, {from, to}) do
    first = infos |> Enum.map(& &1.first) |> Enum.min()
    last = infos |> Enum.map(& &1.last) |> Enum.max()
    [from, to, first, last] = Enum.map([from, to, first, last], &Situ.Time.to_iso8601/1)

    Error.new(:empty_interval, "no messages between #{from} and #{to}",
      why: "the recording spans #{first} to #{last}",
      fix: "choose an interval within that span"
    )
  end

  defp list_sources(store), do: Enum.map(Query.streams(store), &{store, &1})

  # Opens an external file with options that preserve all of its data.
  defp open_source(path, times) do
    reader = if File.regular?(path), do: Formats.for_file(path) || Formats.for_content(path)

    if reader && function_exported?(reader, :import_options, 1),
      do: Query.open(path, reader_opts: reader.import_options(times)),
      else: Query.open(path)
  end

  defp open_all([], _times),
    do: {:error, Error.new(:no_store, "no stores to concatenate", fix: "name at least one")}

  defp open_all(paths, times) do
    Enum.reduce_while(Enum.reverse(paths), {:ok, []}, fn path, {:ok, stores} ->
      case open_source(path, times) do
        {:ok, store} -> {:cont, {:ok, [store | stores]}}
        error -> {:halt, error}
      end
    end)
  end

  defp order_by_time(sources) do
    sources = Enum.sort_by(sources, fn {_, info} -> info.first || 0 end)
    {sources |> List.last() |> elem(1), sources}
  end

  defp check_compatible(parts) do
    Enum.find_value(parts, :ok, fn {info, sources} ->
      check_types(info, sources) || find_overlap(sources)
    end)
  end

  defp check_types(info, sources) do
    if Enum.any?(sources, fn {_, other} -> other.type_name != info.type_name end) do
      types = Enum.map_join(sources, ", ", fn {store, i} -> "#{i.type_name} in #{store.path}" end)

      {:error,
       Error.new(:type_mismatch, "stream #{inspect(info.name)} has different types", why: types)}
    end
  end

  defp find_overlap(sources) do
    sources
    |> Enum.filter(fn {_, info} -> info.first end)
    |> Enum.chunk_every(2, 1, :discard)
    |> Enum.find_value(fn [{_, a}, {_, b}] ->
      if b.first <= a.last do
        {:error,
         Error.new(:overlap, "two recordings of stream #{inspect(a.name)} overlap",
           why: "#{Situ.Time.to_iso8601(b.first)} is not after #{Situ.Time.to_iso8601(a.last)}",
           fix: "crop one of them first"
         )}
      end
    end)
  end

  # Selects streams by predicate, or by names and patterns (`Room.*`), each of which must match at least one stream.
  defp select_streams(infos, nil, _path), do: {:ok, infos}

  defp select_streams(infos, fun, _path) when is_function(fun, 1),
    do: {:ok, Enum.filter(infos, &fun.(elem(&1, 1)))}

  defp select_streams(infos, patterns, path) do
    names = infos |> Enum.map(fn {_, info} -> info.name end) |> Enum.uniq()
    chosen = Map.new(patterns, &{&1, match_names(&1, names)})

    case Enum.find(patterns, &(chosen[&1] == [])) do
      nil ->
        wanted = chosen |> Map.values() |> Enum.concat()
        {:ok, Enum.filter(infos, fn {_, info} -> info.name in wanted end)}

      unknown ->
        {:error, NativeErrors.no_stream_error(unknown, names, path)}
    end
  end

  defp match_names(pattern, names) do
    if pattern in names do
      [pattern]
    else
      regex =
        pattern |> Regex.escape() |> String.replace("\\*", ".*") |> String.replace("\\?", ".")

      Enum.filter(names, &(&1 =~ ~r/\A#{regex}\z/su))
    end
  end

  @doc false
  # `parts` pairs each stream of the new store with the sources of its messages. The option `record:` is a record for
  # its catalog.
  @spec build_store(
          Path.t() | {String.t(), Path.t()},
          [{StreamInfo.t(), [Transfer.source()]}],
          keyword()
        ) :: {:ok, Path.t()} | {:error, Error.t()}
  def build_store(to, parts, opts) do
    infos = for {_, sources} <- parts, {_, info} <- sources, do: info
    report = progress_reporter(infos, opts)

    to
    |> resolve_target()
    |> Draft.build_store(
      put_store_defaults(opts, infos),
      fn writer ->
        with :ok <- write_record(writer, opts[:record]),
             do: Passes.write_streams(writer, parts, opts, report)
      end
    )
  end

  defp write_record(_writer, nil), do: :ok

  defp write_record(writer, record) do
    with {:ok, _} <- Writer.append_catalog(writer, record), do: :ok
  end

  @doc false
  @spec resolve_target(Path.t() | {String.t(), Path.t()}) :: {String.t(), Path.t()}
  def resolve_target({name, root}), do: {name, root}
  def resolve_target(path), do: {Folder.store_name(path), path |> Path.expand() |> Path.dirname()}

  @doc false
  # Returns a function that reports `n` more messages to the caller's `progress`.
  @spec progress_reporter([StreamInfo.t()], keyword()) :: (pos_integer() -> any())
  def progress_reporter(infos, opts) do
    total = infos |> Enum.map(& &1.count) |> Enum.sum()
    done = :counters.new(1, [])
    progress = opts[:progress] || fn _, _ -> :ok end

    fn n ->
      :counters.add(done, 1, n)
      progress.(min(:counters.get(done, 1), total), total)
    end
  end

  @largest 4 * 1024 * 1024
  @smallest 64 * 1024

  @doc false
  # A small store needs only a small first extent, since the disk may be small, too. The copy must not be readable by
  # anyone who cannot read all of the originals.
  @spec put_store_defaults(keyword(), [StreamInfo.t()]) :: keyword()
  def put_store_defaults(opts, infos) do
    stored = infos |> Enum.map(& &1.stored) |> Enum.sum()
    paths = infos |> Enum.map(& &1.store_path) |> Enum.uniq() |> Enum.flat_map(&list_stores/1)
    mode = Folder.mode_of(paths)

    opts = Keyword.put_new(opts, :first_extent, stored |> max(@smallest) |> min(@largest))
    if mode, do: Keyword.put_new(opts, :mode, mode), else: opts
  end

  defp list_stores(path) do
    if path != nil and Segments.segmented?(path), do: Segments.list_folders(path), else: [path]
  end
end
