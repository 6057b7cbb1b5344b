defmodule Situ.Studio.Source.Store do
  @moduledoc """
  Provides a recording as a source: a store's folder or an external file, closed or still being written.

  A table caches the extents and the list of streams briefly, because a page requests them whenever it draws. Thus a
  live page reads the store's catalog once per redraw and not once per panel.
  """
  @behaviour Situ.Studio.Source

  alias Situ.{Error, Store}
  alias Situ.Recording.Formats
  alias Situ.Studio.{StreamTotals, Source, StreamInfo}
  alias Situ.Studio.Draw.{Bins, WindowMessages}

  @enforce_keys [:store, :path, :cache]
  defstruct [:store, :path, :cache]

  @type t :: %__MODULE__{store: Store.t(), path: Path.t(), cache: :ets.table()}

  @fresh_live_ms 30
  @fresh_ms 500
  @samples 2_000
  @inside 8
  # Up to this many messages are read individually, and up to this many changes are returned.
  @few 2_000
  @changes 2_000

  @doc """
  Opens a recording, with options of its reader. The table is deleted when the calling process ends.
  """
  @spec open(Path.t(), keyword()) :: {:ok, Source.t()} | {:error, Error.t()}
  def open(path, reader_opts \\ []) do
    with {:ok, store} <- Store.open(path, reader_opts: reader_opts) do
      cache = :ets.new(__MODULE__, [:set, :public, read_concurrency: true])
      :ets.insert(cache, {:stamp, file_stamp(store.path), Store.live?(store)})
      for info <- Store.streams(store), do: load_type_modules(info.type)
      {:ok, {__MODULE__, %__MODULE__{store: store, path: store.path, cache: cache}}}
    end
  end

  # Field names are atoms that exist only after their struct's module was loaded, and a reader creates no atoms.
  defp load_type_modules(type) when is_atom(type), do: Situ.KnownModules.ensure_loaded?(type)

  defp load_type_modules(type) when is_tuple(type),
    do: type |> Tuple.to_list() |> Enum.each(&load_type_modules/1)

  defp load_type_modules(types) when is_list(types), do: Enum.each(types, &load_type_modules/1)
  defp load_type_modules(_), do: :ok

  @impl true
  def extent(source) do
    with {:ok, %{extent: extent}} <- fetch_catalog(source), do: {:ok, extent}
  end

  @impl true
  def streams(source) do
    with {:ok, %{infos: infos}} <- fetch_catalog(source) do
      {:ok,
       infos
       |> Map.values()
       |> Enum.map(&build_stream_info(source, &1))
       |> Enum.sort_by(& &1.name)}
    end
  end

  # Returns the cached catalog, or reads it again.
  defp fetch_catalog(%__MODULE__{cache: cache} = source) do
    now = System.monotonic_time(:millisecond)

    case :ets.lookup(cache, :look) do
      [{:look, until, look}] when until > now -> {:ok, look}
      _ -> refresh_catalog(source, now)
    end
  rescue
    ArgumentError -> gone_error(source)
  end

  defp refresh_catalog(%__MODULE__{store: store, cache: cache} = source, now) do
    live? = Store.live?(store)

    with :ok <- check_unchanged(source, live?) do
      streams = Store.streams(store)
      {from, to} = Store.interval(streams) || {0, 0}
      extent = %{from: from, to: to, live: live?, version: length(streams)}
      look = %{extent: extent, infos: Map.new(streams, &{&1.name, &1})}
      :ets.insert(cache, {:look, now + if(live?, do: @fresh_live_ms, else: @fresh_ms), look})
      {:ok, look}
    end
  rescue
    error in Error -> {:error, error}
  end

  @impl true
  def damage(%__MODULE__{store: store}) do
    missing =
      for file <- Store.missing_files(store),
          do: "#{Path.basename(file)} is missing, so its messages cannot be read"

    case Store.info(store) do
      %{damage: [_ | _] = damage} -> missing ++ ["#{length(damage)} parts are damaged"]
      _ -> missing
    end
  rescue
    error in Error -> [Exception.message(error)]
  end

  # If the file was deleted and replaced, the open one would keep showing outdated data.
  defp check_unchanged(%__MODULE__{cache: cache} = source, live?) do
    case {file_stamp(source.path), :ets.lookup(cache, :stamp)} do
      {nil, _} ->
        gone_error(source)

      {{inode, _, _}, [{:stamp, {other, _, _}, _}]} when inode != other ->
        replaced_error(source)

      {stamp, [{:stamp, before, false}]} when stamp != before and not live? ->
        replaced_error(source)

      {stamp, _} ->
        :ets.insert(cache, {:stamp, stamp, live?})
        :ok
    end
  end

  # Returns the stamp of a store's index, or of the file itself. Only the inode is compared while a recording is being
  # written. A recording on another machine remains the version that was opened.
  defp file_stamp(path),
    do: if(Formats.for_address(path), do: {:elsewhere, 0, 0}, else: on_disk(path))

  defp on_disk(path) do
    index = Path.join(path, "index.situ")

    case File.stat(if(File.exists?(index), do: index, else: path), time: :posix) do
      {:ok, stat} -> {stat.inode, stat.size, stat.mtime}
      {:error, _} -> nil
    end
  end

  defp replaced_error(source) do
    {:error,
     Error.new(:replaced, "the recording #{Path.basename(source.path)} was replaced by another")}
  end

  defp gone_error(source) do
    {:error, Error.new(:gone, "the recording #{Path.basename(source.path)} no longer exists")}
  end

  defp build_stream_info(source, info) do
    details =
      [
        {"On disk", info.stored > 0 && StreamTotals.format_bytes(info.stored)},
        {"Average size", info.count > 0 && StreamTotals.format_bytes(div(info.size, info.count))},
        {"Compression", info.compression != :none && to_string(info.compression)},
        {"Large messages", info.large? && "stored separately"},
        {"First created", info.first_creation && {:time, info.first_creation}},
        {"Last created", info.last_creation && {:time, info.last_creation}},
        {"Opened", info.opened && {:time, info.opened}},
        {"Closed", info.closed && {:time, info.closed}},
        {"Id", info.id && to_string(info.id)}
      ]
      |> Enum.filter(&elem(&1, 1))

    {shape, keys} = look_inside(source, info)

    %StreamInfo{
      name: info.name,
      shape: shape,
      type: Situ.Type.to_string(info.type),
      first: info.first,
      last: info.last,
      path: if(Formats.for_address(source.path) == nil, do: source.path),
      count: info.count,
      rate: StreamInfo.mean_rate(info.count, info.first, info.last),
      bytes: info.size,
      latency: Store.StreamInfo.average_latency(info),
      keys: keys,
      details: details
    }
  end

  # If a stream's type does not determine its shape or its lanes, some of its messages do.
  defp look_inside(%__MODULE__{cache: cache} = source, info) do
    case {StreamInfo.shape_of_type(info.type), :ets.lookup(cache, {:inside, info.name})} do
      {_, [{_, inside}]} -> inside
      {shape, []} when shape in [:value, :states, :spans] -> look_inside(source, info, shape)
      {shape, []} -> {shape, []}
    end
  end

  defp look_inside(_, %{count: 0}, shape), do: {shape, []}

  defp look_inside(source, info, shape) do
    {:ok, sample} =
      Source.sample_messages({__MODULE__, source}, info.name, info.first, info.last, @inside)

    some = Enum.map(sample, fn {_, message} -> message.data end)

    inside = StreamInfo.refine_shape(shape, some)
    if inside != {:value, []}, do: :ets.insert(source.cache, {{:inside, info.name}, inside})
    inside
  end

  defp fetch_info(source, name) do
    with {:ok, %{infos: infos}} <- fetch_catalog(source) do
      case infos do
        %{^name => info} -> {:ok, info}
        _ -> {:error, Error.new(:no_stream, "unknown stream #{inspect(name)}")}
      end
    end
  end

  @impl true
  def series(source, name, from, to, bin) do
    bins = max(div(to - from, bin), 2)

    with {:ok, info} <- fetch_info(source, name),
         {:ok, n} <- Store.count(source.store, info, from, to) do
      cond do
        elem(look_inside(source, info), 0) == :audio ->
          summary_points(source, info, from, to, bins)

        n <= bins ->
          raw_points(source, info, from, to, n)

        true ->
          summary_points(source, info, from, to, bins)
      end
    end
  end

  defp raw_points(source, info, from, to, n) do
    with {:ok, messages} <- Store.read(source.store, info, from: from, to: to, limit: n + 16) do
      {before, later} =
        WindowMessages.surrounding_messages({__MODULE__, source}, info.name, {from, to}, n)

      {:ok, message_points(before ++ messages ++ later), true}
    end
  end

  defp message_points(messages) do
    for message <- messages,
        point <- Bins.value_points(message.originating_time, message.data),
        do: point
  end

  defp summary_points(source, info, from, to, bins) do
    with {:ok, _width, rows} <- Store.summary(source.store, info, from, to, bins) do
      {:ok, rows, false}
    end
  end

  @impl true
  def summary(source, name, from, to, bins) do
    with {:ok, info} <- fetch_info(source, name),
         {:ok, n} when n > @few <- Store.count(source.store, info, from, to) do
      # The end of a map's key is visible only in the counts of bins.
      keyed? = elem(look_inside(source, info), 0) in [:states, :spans, :value]
      changes = if keyed?, do: 0, else: @changes
      Store.Summary.read(source.store, info, from, to, bins, changes: changes)
    else
      {:ok, _few} -> :none
      error -> error
    end
  end

  @impl true
  def messages(source, name, from, to, limit) do
    with {:ok, info} <- fetch_info(source, name),
         {:ok, messages} <-
           Store.read(source.store, info, from: from, to: to, limit: limit + 1) do
      if length(messages) > limit,
        do: {:ok, Enum.take(messages, limit), :more},
        else: {:ok, messages, :all}
    end
  end

  @impl true
  def marks(source, name, from, to, limit) do
    with {:ok, info} <- fetch_info(source, name),
         {:ok, n} <- Store.count(source.store, info, from, to) do
      if n <= limit,
        do: all_marks(source, info, from, to, n),
        else: sampled_marks(source, info, from, n)
    end
  end

  defp all_marks(source, info, from, to, n) do
    opts = [from: from, to: to, limit: n + 16, envelopes: true]

    with {:ok, messages} <- Store.read(source.store, info, opts) do
      {:ok, Enum.map(messages, &message_mark/1), :all}
    end
  end

  defp sampled_marks(source, info, from, n) do
    with {:ok, rows} <- read_sample(source, info, from, n, @samples, envelopes: true),
         do: {:ok, for({_, message} <- rows, do: message_mark(message)), :more}
  end

  # Reads at most about `keep` of the `n` messages from `from` on, evenly by number.
  defp read_sample(%{store: store}, info, from, n, keep, opts) do
    {:ok, first} = Store.ordinal(store, info, from)

    rows =
      for i <- 0..(min(n, keep) - 1)//1,
          ordinal = first + div(i * n, min(n, keep)),
          {:ok, %Situ.Message{} = m} <- [Store.at(store, info, ordinal, opts)],
          do: {ordinal, m}

    {:ok, rows}
  end

  @impl true
  def sample(source, name, from, to, keep) do
    with {:ok, info} <- fetch_info(source, name),
         {:ok, n} <- Store.count(source.store, info, from, to),
         do: read_sample(source, info, from, n, keep, [])
  end

  defp message_mark(message), do: {message.originating_time, Situ.Message.latency(message)}

  @impl true
  def latest_at(source, name, time) do
    with {:ok, info} <- fetch_info(source, name),
         do: nil_to_none(Store.latest_at(source.store, info, time))
  end

  @impl true
  def next_after(source, name, time) do
    with {:ok, info} <- fetch_info(source, name),
         do: nil_to_none(Store.first_at(source.store, info, time + 1))
  end

  @impl true
  def neighbours(source, name, side, time, n) do
    with {:ok, info} <- fetch_info(source, name),
         {:ok, here} <-
           Store.ordinal(source.store, info, if(side == :before, do: time, else: time + 1)),
         do: read_neighbours(source.store, info, side, here, n)
  end

  defp read_neighbours(_store, _info, :before, 0, _n), do: {:ok, []}

  defp read_neighbours(store, info, :before, here, n) do
    first = max(here - n, 0)

    with {:ok, messages} <- Store.read(store, info, index: first, limit: here - first),
         do: {:ok, Enum.reverse(messages)}
  end

  defp read_neighbours(store, info, :after, here, n),
    do: Store.read(store, info, index: here, limit: n)

  defp nil_to_none({:ok, nil}), do: :none
  defp nil_to_none(other), do: other
end
