defmodule Situ.Dataset.Server do
  @moduledoc """
  A dataset shared by several users: one process holds it, edits go through it one after another, subscribers are told
  of changes.

      iex> {:ok, dataset} = Situ.Dataset.new("Study")
      iex> {:ok, server} = Situ.Dataset.Server.start_link(dataset: dataset)
      iex> :ok = Situ.Dataset.Server.subscribe(server)
      iex> {:ok, _} = Situ.Dataset.Server.edit(server, &Situ.Dataset.add_session(&1, "p01"))
      iex> receive do {:situ_dataset, ^server, changes} -> changes end
      [:dataset, {:session_added, "p01"}]

  Options of `start_link/1`: `dataset:` (required), and those of a GenServer (`name:`). A change is `:dataset`
  (always the first: something in it has changed), `{:session_added, name}`, `{:session_removed, name}` or
  `{:session, name}`; a session renamed or moved gives both `{:session, new}` and `{:session_removed, old}`. It
  ends with its supervisor; nothing unsaved is written then, so use `autosave: true` where that matters.
  """
  use GenServer
  alias Situ.{Dataset, Error}

  @type change ::
          :dataset
          | {:session, String.t()}
          | {:session_added, String.t()}
          | {:session_removed, String.t()}

  @doc "Starts it."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts) do
    {%Dataset{} = dataset, opts} = Keyword.pop!(opts, :dataset)
    GenServer.start_link(__MODULE__, dataset, opts)
  end

  @doc "The dataset as it is now."
  @spec get(GenServer.server()) :: Dataset.t()
  def get(server), do: GenServer.call(server, :get)

  @doc """
  Changes it by a function `dataset -> {:ok, dataset} | {:error, error}`; a function that raises changes nothing
  (`:edit_failed`).
  """
  @spec edit(GenServer.server(), (Dataset.t() -> Dataset.result()), timeout()) :: Dataset.result()
  def edit(server, fun, timeout \\ 60_000) when is_function(fun, 1),
    do: GenServer.call(server, {:edit, fun}, timeout)

  @doc "From now on the caller gets `{:situ_dataset, server_pid, [change]}` after every edit, until it ends."
  @spec subscribe(GenServer.server()) :: :ok
  def subscribe(server), do: GenServer.call(server, {:subscribe, self()})

  @doc """
  The differences between two states of a dataset.

      iex> {:ok, one} = Situ.Dataset.new("Study")
      iex> {:ok, one} = Situ.Dataset.add_session(one, "a")
      iex> {:ok, two} = Situ.Dataset.rename_session(one, "a", "b")
      iex> Situ.Dataset.Server.changes(one, two)
      [:dataset, {:session_removed, "a"}, {:session, "b"}]
  """
  @spec changes(Dataset.t(), Dataset.t()) :: [change()]
  def changes(%Dataset{} = old, %Dataset{} = new) do
    before = Map.new(old.sessions, &{&1.name, &1})
    later = Map.new(new.sessions, &{&1.name, &1})
    removed = for {name, session} <- before, not is_map_key(later, name), do: {name, session}
    added = for session <- new.sessions, not is_map_key(before, session.name), do: session
    gone = Enum.map(removed, fn {_, session} -> session.partitions end)

    told =
      for({name, _} <- removed, do: {:session_removed, name}) ++
        for(
          s <- added,
          do: {if(s.partitions in gone, do: :session, else: :session_added), s.name}
        ) ++
        for s <- new.sessions, old = before[s.name], old != s, do: {:session, s.name}

    same = [:name, :metadata, :tags, :sessions, :unsaved?, :file]
    if Map.take(old, same) == Map.take(new, same), do: [], else: [:dataset | told]
  end

  @impl true
  def init(dataset), do: {:ok, %{dataset: dataset, subscribers: %{}}}

  @impl true
  def handle_call(:get, _from, state), do: {:reply, state.dataset, state}

  def handle_call({:subscribe, pid}, _from, state) do
    subscribers = Map.put_new_lazy(state.subscribers, pid, fn -> Process.monitor(pid) end)
    {:reply, :ok, %{state | subscribers: subscribers}}
  end

  def handle_call({:edit, fun}, _from, state) do
    case edited(fun, state.dataset) do
      {:ok, dataset} ->
        tell(state, changes(state.dataset, dataset))
        {:reply, {:ok, dataset}, %{state | dataset: dataset}}

      {:error, error} ->
        {:reply, {:error, error}, state}
    end
  end

  # The border to a function from outside: the dataset of the others outlives it.
  defp edited(fun, dataset) do
    case fun.(dataset) do
      {:ok, %Dataset{} = dataset} -> {:ok, dataset}
      {:error, %Error{}} = error -> error
      other -> {:error, failed("it answered #{inspect(other, limit: 5)}")}
    end
  rescue
    exception -> {:error, failed(Exception.message(exception))}
  end

  defp failed(why) do
    Error.new(:edit_failed, "the edit of the dataset failed",
      why: why,
      fix: "answer {:ok, dataset}"
    )
  end

  defp tell(_state, []), do: :ok

  defp tell(state, changes),
    do: for({pid, _} <- state.subscribers, do: send(pid, {:situ_dataset, self(), changes}))

  @impl true
  def handle_info({:DOWN, _, :process, pid, _}, state),
    do: {:noreply, %{state | subscribers: Map.delete(state.subscribers, pid)}}

  def handle_info(_, state), do: {:noreply, state}
end
