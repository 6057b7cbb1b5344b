defmodule Situ.Dataset.Server do
  @moduledoc """
  Shares a dataset between several users: one process holds it, applies edits one after another, and notifies
  subscribers of changes.

      iex> {:ok, dataset} = Situ.Dataset.new("Study")
      iex> {:ok, server} = Situ.Dataset.Server.start_link(dataset: dataset)
      iex> :ok = Situ.Dataset.Server.subscribe(server)
      iex> {:ok, _} = Situ.Dataset.Server.edit(server, &Situ.Dataset.add_session(&1, "p01"))
      iex> receive do {:situ_dataset, ^server, changes} -> changes end
      [:dataset, {:session_added, "p01"}]

  A change is `:dataset` (always the first: any part of the dataset has changed), `{:session_added, name}`,
  `{:session_removed, name}` or `{:session, name}`. Renaming or moving a session produces both `{:session, new}` and
  `{:session_removed, old}`. The process ends with its supervisor without saving; use `autosave: true` if edits must not
  be lost.
  """
  use GenServer
  alias Situ.{Dataset, Error}
  alias Situ.EditLog.Document

  @write_ms 1_000

  @type change ::
          :dataset
          | {:session, String.t()}
          | {:session_added, String.t()}
          | {:session_removed, String.t()}

  @doc "Starts the server. Options: `dataset:` (required), and GenServer options such as `name:`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts) do
    {%Dataset{} = dataset, opts} = Keyword.pop!(opts, :dataset)
    GenServer.start_link(__MODULE__, dataset, opts)
  end

  @doc "Returns the current dataset."
  @spec get_dataset(GenServer.server()) :: Dataset.t()
  def get_dataset(server), do: GenServer.call(server, :get)

  @doc """
  Changes the dataset with a function `dataset -> {:ok, dataset} | {:error, error}`. If the function raises, nothing
  changes (`:edit_failed`).
  """
  @spec edit(GenServer.server(), (Dataset.t() -> Dataset.result()), timeout()) :: Dataset.result()
  def edit(server, fun, timeout \\ 60_000) when is_function(fun, 1),
    do: GenServer.call(server, {:edit, fun}, timeout)

  @doc "Subscribes the calling process to `{:situ_dataset, server_pid, [change]}`, which is sent after every edit."
  @spec subscribe(GenServer.server()) :: :ok
  def subscribe(server), do: GenServer.call(server, {:subscribe, self()})

  @doc """
  Returns the differences between two states of a dataset.

      iex> {:ok, one} = Situ.Dataset.new("Study")
      iex> {:ok, one} = Situ.Dataset.add_session(one, "a")
      iex> {:ok, two} = Situ.Dataset.rename_session(one, "a", "b")
      iex> Situ.Dataset.Server.diff_datasets(one, two)
      [:dataset, {:session_removed, "a"}, {:session, "b"}]
  """
  @spec diff_datasets(Dataset.t(), Dataset.t()) :: [change()]
  def diff_datasets(%Dataset{} = old, %Dataset{} = new) do
    before = Map.new(old.sessions, &{&1.name, &1})
    later = Map.new(new.sessions, &{&1.name, &1})
    removed = for {name, session} <- before, not is_map_key(later, name), do: {name, session}
    added = for session <- new.sessions, not is_map_key(before, session.name), do: session
    old_partitions = Enum.map(removed, fn {_, session} -> session.partitions end)

    changes =
      for({name, _} <- removed, do: {:session_removed, name}) ++
        for(
          s <- added,
          do: {if(s.partitions in old_partitions, do: :session, else: :session_added), s.name}
        ) ++
        for s <- new.sessions, old = before[s.name], old != s, do: {:session, s.name}

    same = [:name, :metadata, :tags, :sessions, :unsaved?, :file]
    if Map.take(old, same) == Map.take(new, same), do: [], else: [:dataset | changes]
  end

  @impl true
  def init(dataset), do: {:ok, %{dataset: dataset, subscribers: %{}, timer: nil}}

  @impl true
  def handle_call(:get, _from, state), do: {:reply, state.dataset, state}

  def handle_call({:subscribe, pid}, _from, state) do
    subscribers = Map.put_new_lazy(state.subscribers, pid, fn -> Process.monitor(pid) end)
    {:reply, :ok, %{state | subscribers: subscribers}}
  end

  def handle_call({:edit, fun}, _from, state) do
    case run_edit(fun, state.dataset) do
      {:ok, dataset} ->
        notify_subscribers(state, diff_datasets(state.dataset, dataset))
        {:reply, {:ok, dataset}, schedule_write(%{state | dataset: dataset})}

      {:error, error} ->
        {:reply, {:error, error}, state}
    end
  end

  # Edits of a large dataset are in its log first. The file is written after a pause in the edits.
  defp schedule_write(%{dataset: dataset, timer: timer} = state) do
    if timer, do: Process.cancel_timer(timer)
    due? = dataset.document != nil and Document.write_due?(dataset.document)
    %{state | timer: if(due?, do: Process.send_after(self(), :write_file, @write_ms))}
  end

  # The function comes from the caller: an exception in it must not lose the edits of other users.
  defp run_edit(fun, dataset) do
    case fun.(dataset) do
      {:ok, %Dataset{} = dataset} -> {:ok, dataset}
      {:error, %Error{}} = error -> error
      other -> {:error, edit_error("it returned #{inspect(other, limit: 5)}")}
    end
  rescue
    exception -> {:error, edit_error(Exception.message(exception))}
  end

  defp edit_error(why) do
    Error.new(:edit_failed, "cannot apply the edit to the dataset",
      why: why,
      fix: "return {:ok, dataset} from the function"
    )
  end

  defp notify_subscribers(_state, []), do: :ok

  defp notify_subscribers(state, changes),
    do: for({pid, _} <- state.subscribers, do: send(pid, {:situ_dataset, self(), changes}))

  @impl true
  def handle_info({:DOWN, _, :process, pid, _}, state),
    do: {:noreply, %{state | subscribers: Map.delete(state.subscribers, pid)}}

  # If the file cannot be written, its log still contains the edits.
  def handle_info(:write_file, state) do
    case Dataset.write_file(state.dataset) do
      {:ok, dataset} ->
        notify_subscribers(state, diff_datasets(state.dataset, dataset))
        {:noreply, %{state | dataset: dataset, timer: nil}}

      {:error, _} ->
        {:noreply, %{state | timer: nil}}
    end
  end

  def handle_info(_, state), do: {:noreply, state}
end
