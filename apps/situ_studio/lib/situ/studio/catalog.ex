defmodule Situ.Studio.Catalog do
  @moduledoc """
  What one studio can show: the recordings below its folder, the sources it was given and the pipelines it watches.
  Hands
  out open sources, so that many pages share one; a recording opened once stays open until it is gone.
  """
  use GenServer

  alias Situ.Error
  alias Situ.Studio.{Layouts, Source}

  defmodule Item do
    @moduledoc "One thing to look at; `id` is what stands in the address."
    @enforce_keys [:id, :title, :kind]
    defstruct [:id, :title, :kind, :path, live: false]

    @type t :: %__MODULE__{
            id: String.t(),
            title: String.t(),
            kind: :store | :pipeline | :source,
            path: Path.t() | nil,
            live: boolean()
          }
  end

  @type id :: String.t()

  @doc "Starts the catalog of the studio called `:id`; the other options are those of `Situ.Studio`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, opts, name: via(opts[:id]))

  defp via(id), do: {:via, Registry, {Situ.Studio.Registry, id}}

  @doc false
  def watches(id), do: via({id, :watches})

  @doc "Settings that pages ask for: `:read_only`, `:visualizers`, `:layouts`."
  @spec settings(id()) :: map()
  def settings(id), do: GenServer.call(via(id), :settings)

  @doc "Everything there is to look at now."
  @spec list(id()) :: [Item.t()]
  def list(id), do: GenServer.call(via(id), :list, 30_000)

  @doc "Opens one of them."
  @spec open(id(), String.t()) :: {:ok, Item.t(), Source.t()} | {:error, Error.t()}
  def open(id, item_id), do: GenServer.call(via(id), {:open, item_id}, 60_000)

  @impl true
  def init(opts) do
    settings = %{
      read_only: opts[:read_only] || false,
      visualizers: opts[:visualizers] || [],
      layouts: opts[:layouts] || Layouts.default_dir()
    }

    state = %{
      id: opts[:id],
      settings: settings,
      path: opts[:path],
      given: opts[:sources] || %{},
      pipelines: opts[:pipelines] || [],
      open: %{}
    }

    {:ok, state}
  end

  @impl true
  def handle_call(:settings, _from, state), do: {:reply, state.settings, state}
  def handle_call(:list, _from, state), do: {:reply, items(state), state}

  def handle_call({:open, id}, _from, state) do
    with {:ok, item} <- find(state, id),
         {:ok, source, state} <- source(state, item) do
      {:reply, {:ok, item, source}, state}
    else
      {:error, error} -> {:reply, {:error, error}, state}
    end
  end

  # Only what is listed can be opened: an address names an item, never a path.
  defp find(state, id) do
    case Enum.find(items(state), &(&1.id == id)) do
      nil ->
        {:error,
         Error.new(:not_found, "there is no recording called #{inspect(id)}",
           fix: "choose one from the list"
         )}

      item ->
        {:ok, item}
    end
  end

  defp items(state) do
    given = for {id, _} <- state.given, do: %Item{id: id, title: id, kind: :source}

    stores =
      for {id, path} <- Situ.Studio.Stores.discover(state.path),
          do: %Item{id: id, title: id, kind: :store, path: path}

    running =
      for {id, _} <- Situ.Studio.Source.Pipeline.running(state.pipelines),
          do: %Item{id: id, title: id, kind: :pipeline, live: true}

    # one that was looked at and has ended: what was seen of it is still there
    ended =
      for {id, {Situ.Studio.Source.Pipeline, _}} <- state.open,
          not Enum.any?(running, &(&1.id == id)),
          do: %Item{id: id, title: id, kind: :pipeline, live: false}

    Enum.sort_by(given, & &1.title) ++ running ++ ended ++ stores
  end

  defp source(state, %Item{kind: :source, id: id}), do: {:ok, Map.fetch!(state.given, id), state}

  defp source(state, %Item{id: id} = item) do
    with {:ok, source} <- Map.fetch(state.open, id),
         {:ok, _} <- Source.call(source, :extent, []) do
      {:ok, source, state}
    else
      _ -> open_item(state, item)
    end
  end

  defp open_item(state, %Item{kind: :store} = item) do
    with {:ok, source} <- Situ.Studio.Source.Store.open(item.path) do
      {:ok, source, put_in(state.open[item.id], source)}
    end
  end

  defp open_item(state, %Item{kind: :pipeline} = item) do
    with {:ok, source} <-
           Situ.Studio.Source.Pipeline.open(state.pipelines, item.id, watches(state.id)) do
      {:ok, source, put_in(state.open[item.id], source)}
    end
  end
end
