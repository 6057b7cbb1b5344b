defmodule Situ.Studio.Catalog do
  @moduledoc false
  # Lists the sources of one studio: the recordings in its folder, the configured sources, and the
  # pipelines that it watches. Open sources are shared by all pages; a recording that was opened
  # stays open until it is deleted.
  #
  # A task scans the folder on request and at most every two seconds, so that even in a folder of
  # thousands of files only the first request waits. A recording can be opened by name without a
  # scan.
  use GenServer

  alias Situ.Dataset.{Session, SessionLayers}
  alias Situ.Recording.Formats
  alias Situ.{Dataset, Error}
  alias Situ.Studio.Annotations.Home
  alias Situ.Studio.Datasets.DatasetRef
  alias Situ.Studio.Experiments.DifferencePart
  alias Situ.Studio.{Layouts, RemoteItems, Stores, StreamReader, Recordings}

  # The maximum age of the list of recordings.
  @fresh_ms 2_000

  defmodule Item do
    @moduledoc false
    # Represents an item of the catalog; its `id` is used in addresses. The kind `:elsewhere` is a
    # recording on another machine with the address `path` (`situ://...`), and `:node` is a
    # recording on a cluster node (`NODE/NAME`): nothing is written next to either. A session of a
    # dataset lists its recordings in `parts`; `dataset` is the id of the dataset that an item
    # belongs to. `layers` is the home of its annotation layers (`Situ.Studio.Annotations.Home`),
    # or nil if it cannot have any.
    @enforce_keys [:id, :title, :kind]
    defstruct [:id, :title, :kind, :path, :dataset, :session, :layers, parts: [], live: false]

    @type t :: %__MODULE__{
            id: String.t(),
            title: String.t(),
            kind: :store | :elsewhere | :node | :pipeline | :source | :dataset | :session,
            path: Path.t() | nil,
            dataset: String.t() | nil,
            session: String.t() | nil,
            layers: Situ.Studio.Annotations.Home.t() | nil,
            parts: [{String.t(), Path.t()}],
            live: boolean()
          }
  end

  @type id :: String.t()

  @doc "Starts the catalog of the studio `:id`; the other options are options of `Situ.Studio`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts) do
    settings = %{
      path: opts[:path],
      read_only: opts[:read_only] || false,
      visualizers: opts[:visualizers] || [],
      tiles: opts[:tiles],
      nodes: opts[:recordings] != nil,
      problems:
        for(%{problem: text} = p when text != nil <- opts[:plugins] || [], do: {p.id, text}),
      layouts: opts[:layouts] || Layouts.default_dir()
    }

    name = {:via, Registry, {Situ.Studio.Registry, opts[:id], settings}}
    GenServer.start_link(__MODULE__, opts, name: name)
  end

  defp via(id), do: {:via, Registry, {Situ.Studio.Registry, id}}

  @doc false
  def watch_supervisor(id), do: via({id, :watches})

  @doc """
  Returns the settings for pages: `:path`, `:read_only`, `:visualizers`, `:layouts`, `:tiles`, `:problems` of
  plug-ins.
  """
  @spec settings(id()) :: map()
  def settings(id) do
    # The settings are in the registry, so that reading them never waits for a catalog that opens a recording.
    [{_, settings}] = Registry.lookup(Situ.Studio.Registry, id)
    settings
  end

  @doc "Returns the folder that new recordings and datasets may be written to, or `:error`."
  @spec writable_folder(id()) :: {:ok, Path.t()} | :error
  def writable_folder(id) do
    with %{read_only: false, path: path} when is_binary(path) <- settings(id),
         true <- File.dir?(path) and not Situ.Store.exists?(path),
         do: {:ok, path},
         else: (_ -> :error)
  end

  @doc """
  Adds recordings on another machine to the list until the studio ends: the recordings of a server
  (`situ://lab1`), or a single recording (`situ://lab1/lobby`). Returns their ids. The errors are errors of the link.
  """
  @spec connect(id(), String.t(), token :: String.t()) ::
          {:ok, [String.t()]} | {:error, Error.t()}
  def connect(id, address, token) do
    with {:ok, items} <- RemoteItems.find_items(address, token),
         do: GenServer.call(via(id), {:connect, items}, 30_000)
  end

  @doc "Returns all items that can be opened now."
  @spec list(id()) :: [Item.t()]
  def list(id), do: GenServer.call(via(id), :list, 30_000)

  @doc "Discards the list of recordings, so that the next list includes a recording that was just written."
  @spec invalidate_recordings(id()) :: :ok
  def invalidate_recordings(id), do: GenServer.call(via(id), :look_again, 30_000)

  @doc "Opens an item by its id. An id that is not a string is not found."
  @spec open_source(id(), term()) :: {:ok, Item.t(), Situ.Recording.t()} | {:error, Error.t()}
  def open_source(id, item_id) when is_binary(item_id),
    do: GenServer.call(via(id), {:open, item_id}, 60_000)

  def open_source(_id, item_id), do: {:error, not_found(item_id)}

  @doc "Returns an item by its id without opening it."
  @spec fetch_item(id(), term()) :: {:ok, Item.t()} | {:error, Error.t()}
  def fetch_item(id, item_id) when is_binary(item_id),
    do: GenServer.call(via(id), {:find, item_id}, 60_000)

  def fetch_item(_id, item_id), do: {:error, not_found(item_id)}

  @impl true
  def init(opts) do
    state = %{
      id: opts[:id],
      path: opts[:path],
      sources: opts[:sources] || %{},
      pipelines: opts[:pipelines] || [],
      nodes: opts[:recordings],
      open: %{},
      connected: %{},
      stores: nil,
      looked_at: nil,
      looking: nil,
      waiting: []
    }

    {:ok, state}
  end

  @impl true
  def handle_call(:list, from, state) do
    case refresh_stores(state) do
      %{stores: nil} = state -> {:noreply, %{state | waiting: [from | state.waiting]}}
      state -> {:reply, list_items(state), state}
    end
  end

  def handle_call(:look_again, _from, state) do
    if state.looking, do: Task.shutdown(state.looking, :brutal_kill)
    state = %{state | looking: nil, looked_at: nil, stores: nil}
    {:reply, :ok, if(state.waiting == [], do: state, else: refresh_stores(state))}
  end

  def handle_call({:connect, items}, _from, state) do
    ids = items |> Map.keys() |> Enum.sort()
    {:reply, {:ok, ids}, %{state | connected: Map.merge(state.connected, items)}}
  end

  def handle_call({:find, id}, _from, state), do: {:reply, resolve_item(state, id), state}

  def handle_call({:open, id}, _from, state) do
    with {:ok, item} <- resolve_item(state, id),
         {:ok, source, state} <- fetch_source(state, item) do
      {:reply, {:ok, item, Recordings.DerivedStreams.wrap(source)}, state}
    else
      {:error, error} -> {:reply, {:error, error}, state}
    end
  end

  @impl true
  def handle_info({task, stores}, %{looking: %Task{ref: task}} = state) do
    Process.demonitor(task, [:flush])
    waiting = state.waiting
    state = %{state | stores: stores, looking: nil, looked_at: monotonic_ms(), waiting: []}
    {:noreply, reply_to_waiting(state, waiting)}
  end

  # If the scan crashed, the previous list stays in use.
  def handle_info({:DOWN, task, :process, _, _}, %{looking: %Task{ref: task}} = state) do
    waiting = state.waiting

    state = %{
      state
      | stores: state.stores || {[], []},
        looking: nil,
        looked_at: monotonic_ms(),
        waiting: []
    }

    {:noreply, reply_to_waiting(state, waiting)}
  end

  def handle_info(_stray, state), do: {:noreply, state}

  defp reply_to_waiting(state, waiting) do
    items = list_items(state)
    Enum.each(waiting, &GenServer.reply(&1, items))
    state
  end

  # Scans the folder, unless a scan is running or has just finished.
  defp refresh_stores(%{looking: nil, looked_at: at, path: path} = state) do
    if at == nil or monotonic_ms() - at >= @fresh_ms,
      do: %{
        state
        | looking:
            Task.Supervisor.async_nolink(Situ.Studio.Tasks, fn -> Stores.list_all(path) end)
      },
      else: state
  end

  defp refresh_stores(state), do: state

  defp monotonic_ms, do: System.monotonic_time(:millisecond)

  # An address contains an item's id, never a path, so only recordings in the folder can be opened.
  defp resolve_item(state, id) do
    case Enum.find(source_items(state), &(&1.id == id)) || find_store_item(state, id) ||
           find_dataset_item(state, id) || RemoteItems.get_item(state.connected, id) ||
           find_node_item(state, id) do
      nil ->
        {:error, not_found(id)}

      item ->
        {:ok, item}
    end
  end

  defp not_found(id) do
    Error.new(
      :not_found,
      "there is no recording named #{inspect(id, limit: 5, printable_limit: 200)}",
      fix: "choose one from the list of recordings"
    )
  end

  defp find_store_item(state, id) do
    with {:ok, path} <- Stores.fetch_recording(state.path, id),
         do: store_item(id, path),
         else: (:error -> nil)
  end

  defp store_item(id, path) do
    kind = store_kind(path)
    layers = if kind == :store, do: Home.recording_home(path)
    %Item{id: id, title: id, kind: kind, path: path, layers: layers}
  end

  defp store_kind(path), do: if(Formats.for_address(path), do: :elsewhere, else: :store)
  defp dataset_item(id, path), do: %Item{id: id, title: id, kind: :dataset, path: path}

  # The id of a recording on another cluster node is `NODE/NAME`; the node is asked when it is opened.
  defp find_node_item(%{nodes: nil}, _id), do: nil

  defp find_node_item(_state, id) do
    case String.split(id, "/") do
      [node, name] when name != "" ->
        if String.contains?(node, "@"),
          do: %Item{id: id, title: "#{name} of #{node}", kind: :node, path: id}

      _ ->
        nil
    end
  end

  # Resolves a dataset, one of its sessions, or a recording of a session, whose path is in the dataset.
  defp find_dataset_item(state, id) do
    case Stores.fetch_dataset(state.path, id) do
      {:ok, path} -> dataset_item(id, path)
      :error -> Enum.find_value(DatasetRef.split_id(id), &find_part_item(state, id, &1))
    end
  end

  defp find_part_item(state, id, {dataset, [session | partition]}) do
    with {:ok, file} <- Stores.fetch_dataset(state.path, dataset),
         {:ok, loaded} <- Dataset.load(file),
         {:ok, session} <- Dataset.session(loaded, session),
         do: part_item(id, loaded, session, partition) |> put_dataset(dataset),
         else: (_ -> nil)
  end

  defp put_dataset(nil, _dataset), do: nil
  defp put_dataset(item, dataset), do: %{item | dataset: dataset}

  defp part_item(id, dataset, session, [name]) do
    case Session.fetch_partition(session, name) do
      {:ok, partition} -> %{store_item(id, partition.path) | title: "#{session.name}: #{name}"}
      {:error, _} -> difference_item(id, dataset, session, name)
    end
  end

  # A session with only one recording supports everything that the recording supports, such as the export of a part.
  # The store of its annotation layers is not one of its recordings.
  defp part_item(id, dataset, session, []) do
    case own_parts(session) do
      [{_, path}] ->
        item = store_item(id, path)
        put_session(item, session, Home.session_home(dataset, session.name, path))

      parts ->
        item = %Item{id: id, title: session.name, kind: :session, parts: parts}
        put_session(item, session, Home.session_home(dataset, session.name))
    end
  end

  # The outputs of an experiment's sets are shown with the session's recordings.
  defp difference_item(id, dataset, session, name) do
    with {:ok, path, title} <- DifferencePart.fetch_recording(dataset, name) do
      parts = own_parts(session) ++ [{DifferencePart.part_name(), path}]
      %Item{id: id, title: title, kind: :session, parts: parts}
    else
      :error -> nil
    end
  end

  defp own_parts(session) do
    for p <- session.partitions, not SessionLayers.layers_partition?(p), do: {p.name, p.path}
  end

  defp put_session(item, session, layers),
    do: %{item | title: session.name, session: session.name, layers: layers}

  defp list_items(state) do
    {recordings, datasets} = state.stores || {[], []}

    for({id, path} <- datasets, do: dataset_item(id, path)) ++
      source_items(state) ++
      for({id, path} <- recordings, do: store_item(id, path)) ++
      RemoteItems.list_items(state.connected)
  end

  # Returns all items except the recordings of the folder.
  defp source_items(state) do
    sources = for {id, _} <- state.sources, do: %Item{id: id, title: id, kind: :source}

    running =
      for {id, _} <- Recordings.Pipeline.list_running(state.pipelines),
          do: %Item{id: id, title: id, kind: :pipeline, live: true}

    # A pipeline that was open when it ended stays listed, because the data that was received is still available.
    ended =
      for {{id, _, _, _}, %{module: Recordings.Pipeline}} <- state.open,
          not Enum.any?(running, &(&1.id == id)),
          do: %Item{id: id, title: id, kind: :pipeline, live: false}

    Enum.sort_by(sources, & &1.title) ++ running ++ ended
  end

  defp fetch_source(state, %Item{kind: :source, id: id}),
    do: {:ok, Map.fetch!(state.sources, id), state}

  defp fetch_source(_state, %Item{kind: :dataset, id: id}),
    do: {:error, Error.new(:is_dataset, "#{id} is a dataset", fix: "open one of its sessions")}

  defp fetch_source(state, %Item{} = item) do
    with {:ok, source} <- Map.fetch(state.open, cache_key(item)),
         {:ok, _} <- StreamReader.fetch_extent(source) do
      {:ok, source, state}
    else
      _ -> open_item(state, item)
    end
  end

  # The path is part of the key because a dataset may have been edited to refer to another path.
  defp cache_key(%Item{id: id, path: path, parts: parts, layers: layers}),
    do: {id, path, parts, layers}

  defp open_item(state, %Item{kind: :session} = item) do
    with {:ok, source} <- Recordings.Session.open(item.parts) do
      source = Recordings.Layers.add_layers(source, state.id, item.layers)
      {:ok, source, put_in(state.open[cache_key(item)], source)}
    end
  end

  defp open_item(state, %Item{kind: :node} = item) do
    with {:ok, address, opts} <- state.nodes.(item.id),
         {:ok, source} <- Recordings.Store.open(address, opts) do
      {:ok, source, put_in(state.open[cache_key(item)], source)}
    end
  end

  defp open_item(state, %Item{kind: kind} = item) when kind in [:store, :elsewhere] do
    with {:ok, source} <-
           Recordings.Store.open(item.path, RemoteItems.reader_options(state.connected, item.id)) do
      source = Recordings.Layers.add_layers(source, state.id, item.layers)
      {:ok, source, put_in(state.open[cache_key(item)], source)}
    end
  end

  defp open_item(state, %Item{kind: :pipeline} = item) do
    with {:ok, source} <-
           Recordings.Pipeline.open(state.pipelines, item.id, watch_supervisor(state.id)) do
      {:ok, source, put_in(state.open[cache_key(item)], source)}
    end
  end
end
