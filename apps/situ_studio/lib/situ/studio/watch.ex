defmodule Situ.Studio.Watch do
  @moduledoc """
  Looks into one running pipeline: taps a stream when a page first asks for it, keeps its recent past in a
  `Situ.Studio.History`, and removes the tap when no page has asked for a while.

  Each tap runs behind a lossy queue in a process of its own (`Situ.Pipeline.Tap`); pages read the history. So however
  slow
  or many the pages are, the pipeline only ever hands over messages.
  """
  use GenServer, restart: :temporary

  alias Situ.Error
  alias Situ.Studio.History

  @enforce_keys [:pid, :history, :uses]
  defstruct [:pid, :history, :uses]

  @typedoc "A reader's handle: the process, its history, and the table of the latest request for each stream."
  @type t :: %__MODULE__{pid: pid(), history: History.t(), uses: :ets.table()}

  @sweep_ms 2_000
  @idle_ms 10_000
  @look_ms 500
  @seconds 300

  @doc "Starts watching `target` (a pipeline's pid or name)."
  @spec start_link(Situ.Pipeline.target()) :: GenServer.on_start()
  def start_link(target), do: GenServer.start_link(__MODULE__, target)

  @doc "The handle for readers."
  @spec handle(pid()) :: t()
  def handle(pid), do: GenServer.call(pid, :handle)

  @doc "Notes that a page wants this stream, and taps it when it is not tapped yet."
  @spec want(t(), String.t()) :: :ok | {:error, Error.t()}
  def want(%__MODULE__{uses: uses} = watch, stream) do
    now = System.monotonic_time(:millisecond)

    if :ets.update_element(uses, stream, {2, now}),
      do: :ok,
      else: GenServer.call(watch.pid, {:tap, stream})
  rescue
    ArgumentError -> gone()
  catch
    :exit, _ -> gone()
  end

  @doc "Outputs that have a name: `{stream, type as text}`; and whether the pipeline still runs."
  @spec streams(t()) ::
          {:ok, [{String.t(), String.t()}], running? :: boolean()} | {:error, Error.t()}
  def streams(%__MODULE__{uses: uses, pid: pid}) do
    case :ets.lookup(uses, :streams) do
      [{:streams, until, streams, running?}] ->
        if System.monotonic_time(:millisecond) < until,
          do: {:ok, streams, running?},
          else: GenServer.call(pid, :streams)

      [] ->
        GenServer.call(pid, :streams)
    end
  rescue
    ArgumentError -> gone()
  catch
    :exit, _ -> gone()
  end

  @doc "The pipeline's graph and numbers now."
  @spec snapshot(t()) :: {:ok, Situ.Diagnostics.Snapshot.t()} | {:error, Error.t()}
  def snapshot(%__MODULE__{pid: pid}) do
    GenServer.call(pid, :snapshot)
  catch
    :exit, _ -> gone()
  end

  @doc "Where the message of one originating time is in the pipeline (`Situ.trace/2`)."
  @spec trace(t(), Situ.Time.t()) :: {:ok, Situ.Diagnostics.Trace.t()} | {:error, Error.t()}
  def trace(%__MODULE__{pid: pid}, time) do
    GenServer.call(pid, {:trace, time})
  catch
    :exit, _ -> gone()
  end

  @doc "The pipeline's clock; the wall clock once it has ended."
  @spec now(t()) :: Situ.Time.t()
  def now(%__MODULE__{pid: pid}) do
    GenServer.call(pid, :now)
  catch
    :exit, _ -> Situ.Time.now()
  end

  defp gone, do: {:error, Error.new(:gone, "the pipeline is no longer watched")}

  @impl true
  def init(target) do
    uses = :ets.new(__MODULE__, [:set, :public, read_concurrency: true])
    history = History.new(seconds: @seconds)
    Process.send_after(self(), :sweep, @sweep_ms)
    {:ok, %{target: target, history: history, uses: uses, taps: %{}, streams: []}}
  end

  @impl true
  def handle_call(:handle, _from, state) do
    {:reply, %__MODULE__{pid: self(), history: state.history, uses: state.uses}, state}
  end

  def handle_call({:tap, stream}, _from, state) when is_map_key(state.taps, stream),
    do: {:reply, :ok, state}

  def handle_call({:tap, stream}, _from, state) do
    history = state.history
    keep = fn message -> History.put(history, stream, message, History.weigh(message.data)) end

    case attach(state.target, stream, keep) do
      {:ok, tap} ->
        :ets.insert(state.uses, {stream, System.monotonic_time(:millisecond)})
        {:reply, :ok, put_in(state.taps[stream], tap)}

      {:error, error} ->
        {:reply, {:error, error}, state}
    end
  end

  def handle_call(:now, _from, state), do: {:reply, clock(state.target), state}

  def handle_call(:streams, _from, state) do
    {streams, running?} =
      case outputs(state.target) do
        {:ok, streams} -> {streams, true}
        :ended -> {state.streams, false}
      end

    until = System.monotonic_time(:millisecond) + @look_ms
    :ets.insert(state.uses, {:streams, until, streams, running?})
    {:reply, {:ok, streams, running?}, %{state | streams: streams}}
  end

  def handle_call(:snapshot, _from, state), do: {:reply, info(state.target), state}

  def handle_call({:trace, time}, _from, state) do
    answer =
      try do
        {:ok, Situ.Pipeline.trace(target(state.target), time)}
      rescue
        error in Error -> {:error, error}
      catch
        :exit, _ -> {:error, Error.new(:not_running, "the pipeline has ended")}
      end

    {:reply, answer, state}
  end

  @impl true
  def handle_info(:sweep, state) do
    Process.send_after(self(), :sweep, @sweep_ms)
    old = System.monotonic_time(:millisecond) - @idle_ms

    # a tap went with its pipeline: what a supervisor started in its place is tapped again when it is asked for
    idle =
      for {stream, tap} <- state.taps,
          [{_, used}] <- [:ets.lookup(state.uses, stream)],
          used < old or not alive?(tap.pipeline),
          do: {stream, tap}

    for {stream, tap} <- idle do
      :ets.delete(state.uses, stream)
      detach(tap)
      # one whose pipeline has ended is seen to its end
      if alive?(tap.pipeline), do: History.interrupt(state.history, stream)
    end

    {:noreply, %{state | taps: Map.drop(state.taps, Enum.map(idle, &elem(&1, 0)))}}
  end

  def handle_info(_, state), do: {:noreply, state}

  # It may run on another node of a cluster.
  defp alive?(pid) when node(pid) == node(), do: Process.alive?(pid)

  defp alive?(pid) do
    :erpc.call(node(pid), Process, :alive?, [pid], 1_000)
  catch
    _, _ -> false
  end

  # A pipeline may end at any moment: then there is nothing to tap or to detach.
  defp attach(target, stream, keep) do
    Situ.attach_tap({target(target), stream}, keep, name: "Studio: " <> stream)
  catch
    :exit, _ -> {:error, Error.new(:not_running, "the pipeline has ended")}
  end

  defp detach(tap) do
    Situ.detach_tap(tap)
  catch
    :exit, _ -> :ok
  end

  defp outputs(target) do
    case info(target) do
      {:ok, %{state: state} = info} when state != :completed ->
        streams =
          for node <- info.nodes,
              output <- node.outputs,
              name = output.stream,
              do: {name, output.type}

        {:ok, Enum.uniq_by(streams, &elem(&1, 0))}

      _ ->
        :ended
    end
  end

  defp info(target) do
    {:ok, Situ.Pipeline.info(target(target))}
  rescue
    error in Error -> {:error, error}
  catch
    :exit, _ -> {:error, Error.new(:not_running, "the pipeline has ended")}
  end

  defp clock(target) do
    Situ.Pipeline.now(target(target))
  rescue
    Error -> Situ.Time.now()
  catch
    :exit, _ -> Situ.Time.now()
  end

  @doc false
  def target(fun) when is_function(fun, 0), do: fun.()
  def target(target), do: target
end
