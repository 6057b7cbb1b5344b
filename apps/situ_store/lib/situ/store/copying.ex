defmodule Situ.Store.Copying do
  @moduledoc """
  Stores out of stores: copy, crop, concatenate. Called through `Situ.Store`. Envelopes, types, metadata, codecs and
  payloads are kept as they are, also those that this system has no module for; the originals are only read.

  A new store gets its name when it is complete: a program that ends half way leaves a folder `NAME.*.unfinished`,
  which the next one deletes.
  """
  alias Situ.Error
  alias Situ.Store.Copying.Passes
  alias Situ.Store.{Draft, Failure, Folder, Formats, Reading, StreamInfo}

  @options [
    from: [type: {:optional, :integer}, doc: "The first originating time."],
    to: [type: {:optional, :integer}, doc: "The last one; both ends are included."],
    streams: [
      type: {:or, [{:list, :string}, {:fun, 1}]},
      doc: "Names, patterns like `\"Room.*\"`, or a predicate of `Situ.Store.StreamInfo`."
    ],
    compression: [type: {:in, [:none, :lz4, :zstd]}, doc: "For all streams; else as they are."],
    skip_damage: [type: :boolean, default: true, doc: "Leave damaged chunks out."],
    progress: [type: {:fun, 2}, doc: "`fun.(done, total)` of messages, as it goes."],
    times: [
      type: {:in, [:header, :record]},
      default: :header,
      doc:
        "For bags and MCAP files: whether originating times are the stamps in the headers of messages, where they " <>
          "have one, or the times of recording."
    ],
    empty: [
      type: {:in, [:allow, :refuse]},
      default: :allow,
      doc:
        "Whether an interval without messages gives a store without messages, or the error `:empty_interval`."
    ],
    versioned: [type: :boolean, default: true, doc: "Make a sub-folder `NAME.NNNN`."],
    durability: [
      type: :any,
      default: :none,
      doc:
        "While the store is written, as in `Situ.Store.Writer.create/3`. When it is finished, all of it is on the disk."
    ]
  ]
  @crop_options @options ++
                  [
                    start: [
                      type: :integer,
                      doc: "Ns from the store's first message, for `from:`."
                    ],
                    length: [type: :non_neg_integer, doc: "Ns from there, for `to:`."]
                  ]

  @doc """
  Copies a store (or a foreign file) into a new one: `{:ok, path}`.

  `to` is `{name, root}` or a path (a new version of its last name).

  #{Situ.Options.docs(@options)}
  """
  @spec copy(Path.t(), Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def copy(from, to, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @options),
         {:ok, store} <- open(from, opts[:times]),
         {:ok, sources} <- selected(sources(store), opts[:streams], store.path),
         :ok <- check_interval(sources, opts) do
      build(to, Enum.map(sources, fn {_, info} = source -> {info, [source]} end), opts)
    end
  end

  @earliest -0x8000000000000000
  @latest 0x7FFFFFFFFFFFFFFF

  @compact_options @options
                   |> Keyword.take([:compression, :progress, :durability])
                   |> Keyword.put(:skip_damage,
                     type: :boolean,
                     default: false,
                     doc: "Leave damaged chunks out."
                   )
  @doc """
  Rewrites a store in its place: many small commits become full chunks, holes and what was taken back are gone.
  `{:ok, path}`.

  The new store is complete and on the disk before the two exchange their names in one step, and the old one is deleted
  last. If the program is killed meanwhile, the recording keeps its name. On a file system that cannot exchange names
  it may be left as `NAME.before-compaction`, from which `repair/2` restores it. Damage is an error unless
  `skip_damage: true`.

  #{Situ.Options.docs(@compact_options)}
  """
  @spec compact(Path.t(), keyword()) :: {:ok, Path.t()} | {:error, Error.t()}
  def compact(path, opts \\ []) do
    opts = Keyword.put_new(opts, :durability, {:interval, 10_000})

    with {:ok, opts} <- Situ.Options.validate(opts, @compact_options),
         {:ok, folder} <- own(path),
         {:ok, store} <- Reading.open(folder) do
      parts = for source <- sources(store), do: {elem(source, 1), [source]}
      build({Folder.name(folder), Path.dirname(folder)}, parts, [{:replace, folder} | opts])
    end
  end

  defp own(path) do
    with {:ok, store} <- Reading.open(path) do
      cond do
        not Folder.store?(store.path) ->
          {:error, Error.new(:not_a_store, "#{store.path} is a foreign file, not a store")}

        Reading.live?(store) ->
          {:error, Failure.error(:locked, store.path)}

        true ->
          {:ok, store.path}
      end
    end
  end

  @doc """
  Cuts an interval out: `from:` and `to:` (times), or `start:` and `length:` (ns from the store's first message). Else
  as `copy/3`.
  """
  @spec crop(Path.t(), Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def crop(from, to, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @crop_options),
         {:ok, store} <- open(from, opts[:times]) do
      {first, _last} = Reading.interval(store) || {0, 0}
      start = opts[:from] || first + (opts[:start] || 0)
      stop = opts[:to] || (opts[:length] && start + opts[:length])

      if stop && stop < start do
        {:error, Error.new(:bad_interval, "the interval ends before it begins")}
      else
        copy(
          from,
          to,
          opts |> Keyword.drop([:start, :length]) |> Keyword.merge(from: start, to: stop)
        )
      end
    end
  end

  @doc """
  One store out of several: streams of the same name are appended in order of time; they must be of the same type and
  not overlap. Options as `copy/3`.
  """
  @spec concat([Path.t()], Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def concat(paths, to, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @options),
         {:ok, stores} <- open_all(paths, opts[:times]),
         where = Enum.map_join(stores, ", ", & &1.path),
         {:ok, named} <- selected(Enum.flat_map(stores, &sources/1), opts[:streams], where),
         names = named |> Enum.map(fn {_, info} -> info.name end) |> Enum.uniq(),
         parts =
           for(
             name <- names,
             do: in_time(Enum.filter(named, fn {_, info} -> info.name == name end))
           ),
         :ok <- check(parts),
         :ok <- check_interval(named, opts) do
      build(to, parts, opts)
    end
  end

  # An interval without messages is most likely a mistaken time.
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
    case Reading.first_at(store, info, from) do
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

    Error.new(:empty_interval, "no message lies between #{from} and #{to}",
      why: "the recording goes from #{first} to #{last}",
      fix: "choose an interval within it"
    )
  end

  defp sources(store), do: Enum.map(Reading.streams(store), &{store, &1})

  # A foreign file is opened so that nothing in it is lost.
  defp open(path, times) do
    reader = if File.regular?(path), do: Formats.for_file(path)

    if reader && function_exported?(reader, :import_options, 1),
      do: Reading.open(path, reader_opts: reader.import_options(times)),
      else: Reading.open(path)
  end

  defp open_all([], _times),
    do: {:error, Error.new(:no_store, "no stores to put together", fix: "name at least one")}

  defp open_all(paths, times) do
    Enum.reduce_while(Enum.reverse(paths), {:ok, []}, fn path, {:ok, stores} ->
      case open(path, times) do
        {:ok, store} -> {:cont, {:ok, [store | stores]}}
        error -> {:halt, error}
      end
    end)
  end

  defp in_time(sources) do
    sources = Enum.sort_by(sources, fn {_, info} -> info.first || 0 end)
    {sources |> List.last() |> elem(1), sources}
  end

  defp check(parts) do
    Enum.find_value(parts, :ok, fn {info, sources} ->
      check_types(info, sources) || overlap(sources)
    end)
  end

  defp check_types(info, sources) do
    if Enum.any?(sources, fn {_, other} -> other.type_name != info.type_name end) do
      types = Enum.map_join(sources, ", ", fn {store, i} -> "#{i.type_name} in #{store.path}" end)

      {:error,
       Error.new(:type_mismatch, "stream #{inspect(info.name)} has different types", why: types)}
    end
  end

  defp overlap(sources) do
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

  # By name or pattern (`Room.*`), each of which must mean a stream; or by a predicate.
  defp selected(infos, nil, _path), do: {:ok, infos}

  defp selected(infos, fun, _path) when is_function(fun, 1),
    do: {:ok, Enum.filter(infos, &fun.(elem(&1, 1)))}

  defp selected(infos, patterns, path) do
    names = infos |> Enum.map(fn {_, info} -> info.name end) |> Enum.uniq()
    chosen = Map.new(patterns, &{&1, matching(&1, names)})

    case Enum.find(patterns, &(chosen[&1] == [])) do
      nil ->
        wanted = chosen |> Map.values() |> Enum.concat()
        {:ok, Enum.filter(infos, fn {_, info} -> info.name in wanted end)}

      unknown ->
        {:error, Failure.no_stream(unknown, names, path)}
    end
  end

  defp matching(pattern, names) do
    if pattern in names do
      [pattern]
    else
      regex =
        pattern |> Regex.escape() |> String.replace("\\*", ".*") |> String.replace("\\?", ".")

      Enum.filter(names, &(&1 =~ ~r/\A#{regex}\z/su))
    end
  end

  # `parts`: each stream of the new store with the sources of its messages.
  defp build(to, parts, opts) do
    infos = for {_, sources} <- parts, {_, info} <- sources, do: info
    report = progress_reporter(infos, opts)

    to
    |> target()
    |> Draft.make(sized(opts, infos), &Passes.write(&1, parts, opts, report))
  end

  @doc false
  @spec target(Path.t() | {String.t(), Path.t()}) :: {String.t(), Path.t()}
  def target({name, root}), do: {name, root}
  def target(path), do: {Folder.name(path), path |> Path.expand() |> Path.dirname()}

  @doc false
  # A function that reports `n` more messages to the caller's `progress`.
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
  # A small store needs no large first extent, which a small disk may have no room for; and a copy is for nobody who
  # could not read all of what it is of.
  @spec sized(keyword(), [StreamInfo.t()]) :: keyword()
  def sized(opts, infos) do
    stored = infos |> Enum.map(& &1.stored) |> Enum.sum()
    mode = infos |> Enum.map(& &1.store_path) |> Enum.uniq() |> Folder.mode_of()

    opts = Keyword.put_new(opts, :first_extent, stored |> max(@smallest) |> min(@largest))
    if mode, do: Keyword.put_new(opts, :mode, mode), else: opts
  end
end
