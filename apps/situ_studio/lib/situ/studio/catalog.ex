defmodule Situ.Studio.Catalog do
  @moduledoc """
  The sources of one studio: the recordings below its folder, the sources it was given and the pipelines it watches.
  Hands out open sources, so that many pages share one; a recording opened once stays open until it is gone.

  A task scans the folder, at most every two seconds and only on request, so that in a folder of many thousand files
  only the first request waits. A recording is opened by its name without looking through the rest.
  """
  use GenServer

  alias Situ.Dataset.Session
  alias Situ.Store.Formats
  alias Situ.{Dataset, Error}
  alias Situ.Studio.Datasets.Place
  alias Situ.Studio.{Layouts, Source, Stores}

  # How old the list of recordings may be.
  @fresh_ms 2_000

  defmodule Item do
    @moduledoc """
    One thing to look at; `id` is what stands in the address. `:elsewhere` is a recording of another machine, whose
    `path` is its address (`situ://...`), `:node` one of a node of the cluster (`NODE/NAME`): nothing is written beside
    them. A session of a dataset has `parts`, its recordings; what belongs to a dataset names it by `dataset`, its id.
    """
    @enforce_keys [:id, :title, :kind]
    defstruct [:id, :title, :kind, :path, :dataset, parts: [], live: false]

    @type t :: %__MODULE__{
            id: String.t(),
            title: String.t(),
            kind: :store | :elsewhere | :node | :pipeline | :source | :dataset | :session,
            path: Path.t() | nil,
            dataset: String.t() | nil,
            parts: [{String.t(), Path.t()}],
            live: boolean()
          }
  end

  @type id :: String.t()

  @doc "Starts the catalog of the studio called `:id`; the other options are those of `Situ.Studio`."
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
  def watches(id), do: via({id, :watches})

  @doc """
  Settings that pages ask for: `:path`, `:read_only`, `:visualizers`, `:layouts`, `:tiles`, the `:problems` of plug-ins.
  """
  @spec settings(id()) :: map()
  def settings(id) do
    # beside its name: nobody waits for a catalog that opens a recording
    [{_, settings}] = Registry.lookup(Situ.Studio.Registry, id)
    settings
  end

  @doc "Everything there is to look at now."
  @spec list(id()) :: [Item.t()]
  def list(id), do: GenServer.call(via(id), :list, 30_000)

  @doc "Forgets the list of recordings: a new one was just made, and the next list holds it."
  @spec look_again(id()) :: :ok
  def look_again(id), do: GenServer.call(via(id), :look_again, 30_000)

  @doc "Opens one of them. A value that is no text names nothing."
  @spec open(id(), term()) :: {:ok, Item.t(), Source.t()} | {:error, Error.t()}
  def open(id, item_id) when is_binary(item_id),
    do: GenServer.call(via(id), {:open, item_id}, 60_000)

  def open(_id, item_id), do: {:error, not_found(item_id)}

  @doc "One of them, without opening it."
  @spec find(id(), term()) :: {:ok, Item.t()} | {:error, Error.t()}
  def find(id, item_id) when is_binary(item_id),
    do: GenServer.call(via(id), {:find, item_id}, 60_000)

  def find(_id, item_id), do: {:error, not_found(item_id)}

  @impl true
  def init(opts) do
    state = %{
      id: opts[:id],
      path: opts[:path],
      given: opts[:sources] || %{},
      pipelines: opts[:pipelines] || [],
      nodes: opts[:recordings],
      open: %{},
      stores: nil,
      looked_at: nil,
      looking: nil,
      waiting: []
    }

    {:ok, state}
  end

  @impl true
  def handle_call(:list, from, state) do
    case look(state) do
      %{stores: nil} = state -> {:noreply, %{state | waiting: [from | state.waiting]}}
      state -> {:reply, items(state), state}
    end
  end

  def handle_call(:look_again, _from, state) do
    if state.looking, do: Task.shutdown(state.looking, :brutal_kill)
    state = %{state | looking: nil, looked_at: nil, stores: nil}
    {:reply, :ok, if(state.waiting == [], do: state, else: look(state))}
  end

  def handle_call({:find, id}, _from, state), do: {:reply, found(state, id), state}

  def handle_call({:open, id}, _from, state) do
    with {:ok, item} <- found(state, id),
         {:ok, source, state} <- source(state, item) do
      {:reply, {:ok, item, Source.Derived.wrap(source)}, state}
    else
      {:error, error} -> {:reply, {:error, error}, state}
    end
  end

  @impl true
  def handle_info({task, stores}, %{looking: %Task{ref: task}} = state) do
    Process.demonitor(task, [:flush])
    waiting = state.waiting
    state = %{state | stores: stores, looking: nil, looked_at: now(), waiting: []}
    {:noreply, answer(state, waiting)}
  end

  # The previous list is better than none.
  def handle_info({:DOWN, task, :process, _, _}, %{looking: %Task{ref: task}} = state) do
    waiting = state.waiting

    state = %{
      state
      | stores: state.stores || {[], []},
        looking: nil,
        looked_at: now(),
        waiting: []
    }

    {:noreply, answer(state, waiting)}
  end

  def handle_info(_stray, state), do: {:noreply, state}

  defp answer(state, waiting) do
    items = items(state)
    Enum.each(waiting, &GenServer.reply(&1, items))
    state
  end

  # Looks through the folder, unless that is under way or was done a moment ago.
  defp look(%{looking: nil, looked_at: at, path: path} = state) do
    if at == nil or now() - at >= @fresh_ms,
      do: %{
        state
        | looking: Task.Supervisor.async_nolink(Situ.Studio.Tasks, fn -> Stores.all(path) end)
      },
      else: state
  end

  defp look(state), do: state

  defp now, do: System.monotonic_time(:millisecond)

  # An address names an item, never a path: only recordings below the folder can be opened.
  defp found(state, id) do
    case Enum.find(given(state), &(&1.id == id)) || store(state, id) || of_dataset(state, id) ||
           of_node(state, id) do
      nil ->
        {:error, not_found(id)}

      item ->
        {:ok, item}
    end
  end

  defp not_found(id) do
    Error.new(
      :not_found,
      "there is no recording called #{inspect(id, limit: 5, printable_limit: 200)}",
      fix: "choose one from the list of recordings"
    )
  end

  defp store(state, id) do
    with {:ok, path} <- Stores.find(state.path, id),
         do: store_item(id, path),
         else: (:error -> nil)
  end

  defp store_item(id, path), do: %Item{id: id, title: id, kind: kind(path), path: path}
  defp kind(path), do: if(Formats.for_address(path), do: :elsewhere, else: :store)
  defp dataset_item(id, path), do: %Item{id: id, title: id, kind: :dataset, path: path}

  # A recording of another node of the cluster, `NODE/NAME`: opening it asks the node.
  defp of_node(%{nodes: nil}, _id), do: nil

  defp of_node(_state, id) do
    case String.split(id, "/") do
      [node, name] when name != "" ->
        if String.contains?(node, "@"),
          do: %Item{id: id, title: "#{name} of #{node}", kind: :node, path: id}

      _ ->
        nil
    end
  end

  # A dataset, a session of it, or a recording of that: the dataset says where it lies.
  defp of_dataset(state, id) do
    case Stores.dataset(state.path, id) do
      {:ok, path} -> dataset_item(id, path)
      :error -> Enum.find_value(Place.splits(id), &part(state, id, &1))
    end
  end

  defp part(state, id, {dataset, [session | partition]}) do
    with {:ok, file} <- Stores.dataset(state.path, dataset),
         {:ok, loaded} <- Dataset.load(file),
         {:ok, session} <- Dataset.session(loaded, session),
         do: part_item(id, dataset, session, partition),
         else: (_ -> nil)
  end

  defp part_item(id, dataset, session, [name]) do
    with {:ok, partition} <- Session.partition(session, name) do
      title = "#{session.name}: #{name}"
      %{store_item(id, partition.path) | title: title, dataset: dataset}
    else
      _ -> nil
    end
  end

  # A session with a single recording can be annotated and exported like that recording.
  defp part_item(id, dataset, %{partitions: [one]} = session, []),
    do: %{store_item(id, one.path) | title: session.name, dataset: dataset}

  defp part_item(id, dataset, session, []) do
    parts = for p <- session.partitions, do: {p.name, p.path}
    %Item{id: id, title: session.name, kind: :session, parts: parts, dataset: dataset}
  end

  defp items(state) do
    {recordings, datasets} = state.stores || {[], []}

    for({id, path} <- datasets, do: dataset_item(id, path)) ++
      given(state) ++ for {id, path} <- recordings, do: store_item(id, path)
  end

  # Everything but the recordings of the folder.
  defp given(state) do
    given = for {id, _} <- state.given, do: %Item{id: id, title: id, kind: :source}

    running =
      for {id, _} <- Situ.Studio.Source.Pipeline.running(state.pipelines),
          do: %Item{id: id, title: id, kind: :pipeline, live: true}

    # one that was looked at and has ended: what was seen of it is still there
    ended =
      for {{id, _, _}, {Situ.Studio.Source.Pipeline, _}} <- state.open,
          not Enum.any?(running, &(&1.id == id)),
          do: %Item{id: id, title: id, kind: :pipeline, live: false}

    Enum.sort_by(given, & &1.title) ++ running ++ ended
  end

  defp source(state, %Item{kind: :source, id: id}), do: {:ok, Map.fetch!(state.given, id), state}

  defp source(_state, %Item{kind: :dataset, id: id}),
    do: {:error, Error.new(:is_dataset, "#{id} is a dataset", fix: "open one of its sessions")}

  defp source(state, %Item{} = item) do
    with {:ok, source} <- Map.fetch(state.open, key(item)),
         {:ok, _} <- Source.call(source, :extent, []) do
      {:ok, source, state}
    else
      _ -> open_item(state, item)
    end
  end

  # A dataset may say another place of it by now.
  defp key(%Item{id: id, path: path, parts: parts}), do: {id, path, parts}

  defp open_item(state, %Item{kind: :session} = item) do
    with {:ok, source} <- Source.Session.open(item.parts) do
      {:ok, source, put_in(state.open[key(item)], source)}
    end
  end

  defp open_item(state, %Item{kind: :node} = item) do
    with {:ok, address, opts} <- state.nodes.(item.id),
         {:ok, source} <- Situ.Studio.Source.Store.open(address, opts) do
      {:ok, source, put_in(state.open[key(item)], source)}
    end
  end

  defp open_item(state, %Item{kind: kind} = item) when kind in [:store, :elsewhere] do
    with {:ok, source} <- Situ.Studio.Source.Store.open(item.path) do
      {:ok, source, put_in(state.open[key(item)], source)}
    end
  end

  defp open_item(state, %Item{kind: :pipeline} = item) do
    with {:ok, source} <-
           Situ.Studio.Source.Pipeline.open(state.pipelines, item.id, watches(state.id)) do
      {:ok, source, put_in(state.open[key(item)], source)}
    end
  end
end
