defmodule Situ.Store.Copying do
  @moduledoc """
  Stores out of stores: copy, crop, concatenate. Called through `Situ.Store`. Envelopes, metadata and types are kept; the
  originals are only read.
  """
  alias Situ.{Error, Store}
  alias Situ.Store.{Folder, StreamInfo, Writer}

  @doc """
  Copies a store (or a foreign file) into a new one: `{:ok, path}`.

  `to` is `{name, root}` or a path (a new version of its last name). Options: `from:`, `to:` (originating times, both ends
  included), `streams:` (names, or a predicate of `Situ.Store.StreamInfo`), `compression:` (for all streams), `skip_damage:` (default true: leave
  damaged chunks out), `progress:` (`fun.(done, total)` of messages), `versioned:`.
  """
  @spec copy(Path.t(), Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def copy(from, to, opts \\ []) do
    with {:ok, store} <- Store.open(from) do
      streams = selected(store, opts[:streams])
      parts = Enum.map(streams, &{&1, [{store, &1}]})
      build(to, parts, opts)
    end
  end

  @doc """
  Cuts an interval out: `from:` and `to:` (times), or `start:` and `length:` (ns from the store's first message). Else as `copy/3`.
  """
  @spec crop(Path.t(), Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def crop(from, to, opts) do
    with {:ok, store} <- Store.open(from) do
      {first, _last} = Store.interval(store) || {0, 0}
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
  One store out of several: streams of the same name are appended in order of time; they must be of the same type and not
  overlap. Options as `copy/3`.
  """
  @spec concat([Path.t()], Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def concat(paths, to, opts \\ []) do
    with {:ok, stores} <- open_all(paths),
         named = for(store <- stores, info <- selected(store, opts[:streams]), do: {store, info}),
         names = named |> Enum.map(fn {_, info} -> info.name end) |> Enum.uniq(),
         parts =
           for(
             name <- names,
             do: in_time(Enum.filter(named, fn {_, info} -> info.name == name end))
           ),
         :ok <- check(parts) do
      build(to, parts, opts)
    end
  end

  defp open_all(paths) do
    Enum.reduce_while(Enum.reverse(paths), {:ok, []}, fn path, {:ok, stores} ->
      case Store.open(path) do
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

  defp selected(store, nil), do: Store.streams(store)
  defp selected(store, fun) when is_function(fun, 1), do: Enum.filter(Store.streams(store), fun)
  defp selected(store, names), do: Enum.filter(Store.streams(store), &(&1.name in names))

  @doc false
  def build(to, parts, opts) do
    {name, root} = target(to)
    total = for({_, sources} <- parts, {_, info} <- sources, do: info.count) |> Enum.sum()

    with {:ok, writer} <- Writer.create(name, root, Keyword.take(opts, [:versioned, :durability])) do
      case write(writer, parts, opts, total) do
        :ok ->
          with :ok <- Writer.close(writer), do: {:ok, writer.path}

        {:error, _} = error ->
          # Half a copy is no copy.
          Writer.close(writer)
          Situ.Store.Mending.delete(writer.path)
          error
      end
    end
  end

  @doc false
  def target({name, root}), do: {name, root}
  def target(path), do: {Folder.name(path), path |> Path.expand() |> Path.dirname()}

  defp write(writer, parts, opts, total) do
    Enum.reduce_while(parts, {:ok, 0}, fn {info, sources}, {:ok, done} ->
      with {:ok, stream} <- Writer.stream(writer, info.name, stream_options(info, sources, opts)),
           {:ok, stream, done} <- messages(stream, sources, opts, done, total),
           {:ok, _} <- close(stream, info, opts) do
        {:cont, {:ok, done}}
      else
        error -> {:halt, error}
      end
    end)
    |> case do
      {:ok, _} -> :ok
      error -> error
    end
  end

  defp close(_stream, %{closed: nil}, _opts), do: {:ok, 0}

  defp close(stream, %{closed: time}, opts),
    do: Writer.close_stream(stream, min_time(time, opts[:to]))

  defp min_time(time, nil), do: time
  defp min_time(time, to), do: min(time, to)

  @doc false
  def stream_options(%StreamInfo{} = info, sources, opts) do
    options = [
      type: info.type,
      large: info.large?,
      compression: opts[:compression] || info.compression
    ]

    with [{store, _} | _] <- sources, {:ok, term} <- Store.metadata(store, info) do
      [{:metadata, term} | options]
    else
      _ -> options
    end
  end

  defp messages(stream, sources, opts, done, total) do
    progress = opts[:progress] || fn _, _ -> :ok end

    read =
      Keyword.take(opts, [:from, :to]) ++ [skip_damage: Keyword.get(opts, :skip_damage, true)]

    sources
    |> Stream.flat_map(fn {store, info} ->
      transform = opts[:transform] || (& &1)
      store |> Store.messages(info, read) |> transform.()
    end)
    |> Stream.chunk_every(1_000)
    |> Enum.reduce_while({:ok, stream, done}, fn batch, {:ok, stream, done} ->
      case Writer.append(stream, batch) do
        {:ok, stream} ->
          progress.(min(done + length(batch), total), total)
          {:cont, {:ok, stream, done + length(batch)}}

        error ->
          {:halt, error}
      end
    end)
  rescue
    error in Error -> {:error, error}
  end
end
