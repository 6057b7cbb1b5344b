defmodule Situ.Store.OpenRecordings do
  @moduledoc false
  # Knows the recordings that pipelines of this node are writing, for `Situ.Store.StoreMetrics`. The process that writes
  # a recording adds its writers. They are forgotten when it ends.
  #
  # A reference to a writer holds the lock of its store. So it stays in the dictionary of the process that writes, and
  # this process never has one: when a writing process is killed, the store is free at once.
  use GenServer
  alias Situ.Store.Writer

  @spec start_link(term()) :: GenServer.on_start()
  def start_link(_), do: GenServer.start_link(__MODULE__, %{}, name: __MODULE__)

  @doc "Adds a writer of the calling process."
  @spec add_writer(Writer.t()) :: :ok
  def add_writer(%Writer{path: path, name: name} = writer) do
    Process.put({__MODULE__, path}, writer)
    GenServer.cast(__MODULE__, {:add, self(), path, name})
  end

  @doc """
  Removes a writer before it is closed, by any process. Its bytes still count for the recording while the process that
  added it is alive.
  """
  @spec remove_writer(Writer.t()) :: :ok
  def remove_writer(%Writer{path: path} = writer) do
    bytes = Writer.stored_bytes(writer)
    Process.delete({__MODULE__, path})
    GenServer.cast(__MODULE__, {:remove, path, bytes})
  end

  @doc "Returns the names of the recordings that are being written, and the bytes written so far."
  @spec list_recordings() :: %{String.t() => non_neg_integer()}
  def list_recordings do
    # The references are read in a process that ends, so that none of them waits for garbage collection.
    owners = GenServer.call(__MODULE__, :list)
    fn -> Enum.flat_map(owners, &list_sizes/1) end |> Task.async() |> Task.await() |> add_sizes()
  end

  defp add_sizes(sizes) do
    Enum.reduce(sizes, %{}, fn {name, bytes}, sums ->
      Map.update(sums, name, bytes, &(&1 + bytes))
    end)
  end

  defp list_sizes({owner, entry}) do
    case Process.info(owner, :dictionary) do
      {:dictionary, dictionary} -> Map.to_list(entry.finished) ++ open_sizes(entry, dictionary)
      nil -> []
    end
  end

  defp open_sizes(%{open: open}, dictionary) do
    for {{__MODULE__, path}, writer} <- dictionary,
        is_map_key(open, path),
        do: {open[path], Writer.stored_bytes(writer)}
  end

  @impl true
  def init(owners), do: {:ok, owners}

  @impl true
  def handle_cast({:add, owner, path, name}, owners) do
    unless is_map_key(owners, owner), do: Process.monitor(owner)
    entry = Map.get(owners, owner, %{open: %{}, finished: %{}})
    {:noreply, Map.put(owners, owner, put_in(entry.open[path], name))}
  end

  def handle_cast({:remove, path, bytes}, owners) do
    {:noreply, Map.new(owners, fn {owner, entry} -> {owner, finish(entry, path, bytes)} end)}
  end

  defp finish(%{open: open, finished: finished} = entry, path, bytes) do
    case Map.pop(open, path) do
      {nil, _open} ->
        entry

      {name, open} ->
        %{entry | open: open, finished: Map.update(finished, name, bytes, &(&1 + bytes))}
    end
  end

  @impl true
  def handle_call(:list, _from, owners), do: {:reply, owners, owners}

  @impl true
  def handle_info({:DOWN, _ref, :process, owner, _reason}, owners),
    do: {:noreply, Map.delete(owners, owner)}

  def handle_info(_other, owners), do: {:noreply, owners}
end
