defmodule Situ.Store.Compaction do
  @moduledoc false
  # Rewrites stores in place. Called through `Situ.Store.compact/2`.
  alias Situ.Error

  alias Situ.Store.{
    Catalog,
    Copying,
    Folder,
    NativeErrors,
    NativeFormat,
    Query,
    SegmentedRecording,
    Segments
  }

  @options Copying.copy_options()
           |> Keyword.take([:compression, :progress, :durability])
           |> Keyword.put(:skip_damage,
             type: :boolean,
             default: false,
             doc: "Skip damaged chunks."
           )

  @spec compact_options() :: Situ.Options.schema()
  def compact_options, do: @options

  @spec compact(Path.t(), keyword()) :: {:ok, Path.t()} | {:error, Error.t()}
  def compact(path, opts \\ []) do
    opts = Keyword.put_new(opts, :durability, {:interval, 10_000})

    with {:ok, opts} <- Situ.Options.validate(opts, @options),
         {:ok, store} <- open_own_store(path) do
      if store.module == SegmentedRecording,
        do: compact_segments(store.path, Segments.list_folders(store.path), opts),
        else: compact_folder(store.path, opts)
    end
  end

  # The progress counts the messages of all segments.
  defp compact_segments(path, folders, opts) do
    with {:ok, stores} <- Error.map_ok(folders, &open_own_store/1) do
      totals =
        for store <- stores, do: store |> Query.streams() |> Enum.map(& &1.count) |> Enum.sum()

      total = Enum.sum(totals)
      progress = opts[:progress] || fn _, _ -> :ok end

      folders
      |> Enum.zip(Enum.scan([0 | totals], &+/2))
      |> Error.map_ok(fn {folder, before} ->
        report = fn done, _ -> progress.(before + done, total) end
        compact_folder(folder, Keyword.put(opts, :progress, report))
      end)
      |> case do
        {:ok, _} -> {:ok, path}
        error -> error
      end
    end
  end

  # A segment remains a segment.
  defp compact_folder(folder, opts) do
    with {:ok, store} <- Query.open(folder) do
      parts =
        for source <- Enum.map(Query.streams(store), &{store, &1}),
            do: {elem(source, 1), [source]}

      mark = Catalog.segment_record(Query.info(store).piece)

      Copying.build_store({Folder.store_name(folder), Path.dirname(folder)}, parts, [
        {:replace, folder},
        {:record, mark} | opts
      ])
    end
  end

  defp open_own_store(path) do
    with {:ok, store} <- Query.open(path) do
      cond do
        store.module not in [NativeFormat, SegmentedRecording] ->
          {:error, Error.new(:not_a_store, "#{store.path} is an external file, not a store")}

        Query.live?(store) ->
          {:error, NativeErrors.to_error(:locked, store.path)}

        true ->
          {:ok, store}
      end
    end
  end
end
