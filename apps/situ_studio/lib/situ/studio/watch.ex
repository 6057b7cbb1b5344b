defmodule Situ.Studio.Watch do
  @moduledoc """
  Watches one running pipeline: taps a stream when a page first requests it, stores its recent messages in a
  `Situ.Studio.History`, and removes the tap when no page has requested the stream for a while.

  Each tap has a lossy queue in a separate process (`Situ.Pipeline.Tap`), and pages read only the history. However
  slow or numerous the pages are, the pipeline only hands over messages.

  A target function is called again when its pipeline has ended or was replaced, for example by a supervisor restart
  or a failover to another cluster node. Streams of the new pipeline are tapped when a page requests them; the time in
  between is a gap (`Situ.Studio.Hole`).
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
  # A cluster node may be suspended; calls to it time out after this time.
  @answer_ms 2_000
  # A pipeline that is missing for less than this time may still be restarted here or on another node.
  @return_ms 6_000

  @doc "Starts watching `target`: a pipeline's pid or name, or a function that finds it."
  @spec start_link(Situ.Pipeline.target() | (() -> Situ.Pipeline.target() | nil)) ::
          GenServer.on_start()
  def start_link(target), do: GenServer.start_link(__MODULE__, target)

  @doc "Returns the handle for readers."
  @spec handle(pid()) :: t()
  def handle(pid), do: GenServer.call(pid, :handle)

  @doc "Records that a page needs this stream, and taps it if it is not tapped yet."
  @spec want(t(), String.t()) :: :ok | {:error, Error.t()}
  def want(%__MODULE__{uses: uses} = watch, stream) do
    if :ets.update_element(uses, stream, {2, now()}),
      do: :ok,
      else: GenServer.call(watch.pid, {:tap, stream})
  rescue
    ArgumentError -> gone()
  catch
    :exit, _ -> gone()
  end

  @doc "Returns the named outputs as `{stream, type as text}`, and whether the pipeline is still running."
  @spec streams(t()) ::
          {:ok, [{String.t(), String.t()}], running? :: boolean()} | {:error, Error.t()}
  def streams(%__MODULE__{uses: uses, pid: pid}) do
    case :ets.lookup(uses, :streams) do
      [{:streams, until, streams, running?}] ->
        if now() < until,
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

  @doc "Returns the pipeline's current graph and statistics."
  @spec snapshot(t()) :: {:ok, Situ.Diagnostics.Snapshot.t()} | {:error, Error.t()}
  def snapshot(%__MODULE__{pid: pid}) do
    GenServer.call(pid, :snapshot)
  catch
    :exit, _ -> gone()
  end

  @doc "Returns the path through the pipeline of the message with an originating time (`Situ.trace/2`)."
  @spec trace(t(), Situ.Time.t()) :: {:ok, Situ.Diagnostics.Trace.t()} | {:error, Error.t()}
  def trace(%__MODULE__{pid: pid}, time) do
    GenServer.call(pid, {:trace, time})
  catch
    :exit, _ -> gone()
  end

  @doc "Returns the time of the pipeline's clock, or the wall-clock time if the pipeline has ended."
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
    state = %{target: target, history: history, uses: uses, taps: %{}, streams: []}
    {:ok, Map.merge(state, %{ran: now(), away: now()})}
  end

  @impl true
  def handle_call(:handle, _from, state) do
    {:reply, %__MODULE__{pid: self(), history: state.history, uses: state.uses}, state}
  end

  def handle_call({:tap, stream}, _from, state) when is_map_key(state.taps, stream),
    do: {:reply, :ok, state}

  # Pages repeat a request many times a second, so a failed target is retried only after a delay.
  def handle_call({:tap, stream}, _from, state) do
    if now() < state.away do
      {:reply, {:error, ended()}, state}
    else
      {answer, state} = begin(state, stream)
      {:reply, answer, state}
    end
  end

  def handle_call(:now, _from, state), do: {:reply, clock(state.target), state}

  def handle_call(:streams, _from, state) do
    {found, state} = look(state)

    {streams, running?, state} =
      case found do
        {:ok, streams} -> {streams, true, %{state | ran: now()}}
        :ended -> {state.streams, returns?(state), state}
      end

    :ets.insert(state.uses, {:streams, now() + @look_ms, streams, running?})
    {:reply, {:ok, streams, running?}, %{state | streams: streams}}
  end

  def handle_call(:snapshot, _from, state), do: {:reply, info(state.target), state}

  def handle_call({:trace, time}, _from, state) do
    answer =
      try do
        {:ok, ask(target(state.target), :trace, [time])}
      rescue
        error in Error -> {:error, error}
      catch
        _, _ -> {:error, ended()}
      end

    {:reply, answer, state}
  end

  @impl true
  def handle_info(:sweep, state) do
    Process.send_after(self(), :sweep, @sweep_ms)
    old = now() - @idle_ms

    idle =
      for {stream, _} <- state.taps,
          [{_, used}] <- [:ets.lookup(state.uses, stream)],
          used < old do
        History.interrupt(state.history, stream, History.last(state.history, stream))
        stream
      end

    {:noreply, let_go(state, idle)}
  end

  # The replacement pipeline is tapped when a page requests the stream again.
  def handle_info({:DOWN, _, :process, pipeline, _}, state),
    do: {:noreply, let_go(state, tapped(state, &(&1 == pipeline)))}

  def handle_info(_, state), do: {:noreply, state}

  defp now, do: System.monotonic_time(:millisecond)

  # Returns the current streams. Removes taps on a pipeline that was replaced: its node may be suspended while the
  # part is running on another node.
  defp look(%{target: target} = state) do
    case target(target) do
      pid when is_function(target, 0) and is_pid(pid) ->
        {outputs(pid), let_go(state, tapped(state, &(&1 != pid)))}

      target ->
        {outputs(target), state}
    end
  end

  defp returns?(%{target: target, ran: ran}),
    do: is_function(target, 0) and now() < ran + @return_ms

  defp begin(%{history: history} = state, stream) do
    keep = fn message -> History.put(history, stream, message, History.weigh(message.data)) end
    last = History.last(history, stream)

    case attach(state.target, stream, keep) do
      {:ok, tap} ->
        # The time since the stream was last tapped is unknown.
        History.interrupt(history, stream, last)
        :ets.insert(state.uses, {stream, now()})
        {:ok, put_in(state.taps[stream], {tap, Process.monitor(tap.pipeline)})}

      {:error, %{code: :not_running} = error} ->
        {{:error, error}, %{state | away: now() + @look_ms}}

      {:error, error} ->
        {{:error, error}, state}
    end
  end

  defp tapped(state, which?),
    do: for({stream, {tap, _}} <- state.taps, which?.(tap.pipeline), do: stream)

  defp let_go(state, streams) do
    {gone, taps} = Map.split(state.taps, streams)

    for {stream, {tap, monitor}} <- gone do
      :ets.delete(state.uses, stream)
      Process.demonitor(monitor, [:flush])
      detach(tap)
    end

    %{state | taps: taps}
  end

  # A pipeline may end at any time, so attaching and detaching may exit.
  defp attach(target, stream, keep) do
    Situ.attach_tap({target(target), stream}, keep, name: "Studio: " <> stream)
  catch
    :exit, _ -> {:error, ended()}
  end

  # A remote tap is detached in a task, so that the watcher never waits for another node.
  defp detach(%{pipeline: pid} = tap) when node(pid) != node(),
    do: Task.start(fn -> take_away(tap) end)

  defp detach(tap), do: take_away(tap)

  defp take_away(tap) do
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
    {:ok, ask(target(target), :info, [])}
  rescue
    error in Error -> {:error, error}
  catch
    _, _ -> {:error, ended()}
  end

  defp ended, do: Error.new(:not_running, "the pipeline has ended")

  defp clock(target) do
    ask(target(target), :now, [])
  rescue
    Error -> Situ.Time.now()
  catch
    _, _ -> Situ.Time.now()
  end

  defp ask(pid, function, args) when is_pid(pid) and node(pid) != node(),
    do: :erpc.call(node(pid), Situ.Pipeline, function, [pid | args], @answer_ms)

  defp ask(target, function, args), do: apply(Situ.Pipeline, function, [target | args])

  # The process that the function calls may also have exited.
  @doc false
  def target(fun) when is_function(fun, 0) do
    fun.()
  catch
    _, _ -> nil
  end

  def target(target), do: target
end
