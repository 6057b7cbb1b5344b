defmodule Situ.Studio.PipelineWatcher do
  @moduledoc false
  # Watches one running pipeline: taps a stream when a page first requests it, stores its recent
  # messages in a `Situ.Studio.History`, and removes the tap when no page has requested the stream
  # for a while.
  #
  # Each tap has a lossy queue in a separate process (`Situ.attach_tap/3`), and pages read only
  # the history. However slow or numerous the pages are, the pipeline only hands over messages.
  #
  # A target function is called again when its pipeline has ended or was replaced, for example by
  # a supervisor restart or a failover to another cluster node. Streams of the new pipeline are
  # tapped when a page requests them; the time in between is a gap (`Situ.Studio.Gap`).
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
  @spec reader_handle(pid()) :: t()
  def reader_handle(pid), do: GenServer.call(pid, :handle)

  @doc "Records that a page needs this stream, and taps it if it is not tapped yet."
  @spec request_stream(t(), String.t()) :: :ok | {:error, Error.t()}
  def request_stream(%__MODULE__{uses: uses} = watch, stream) do
    if :ets.update_element(uses, stream, {2, monotonic_ms()}),
      do: :ok,
      else: GenServer.call(watch.pid, {:tap, stream})
  rescue
    ArgumentError -> gone_error()
  catch
    :exit, _ -> gone_error()
  end

  @doc "Returns the named outputs as `{stream, type as text}`, and whether the pipeline is still running."
  @spec list_streams(t()) ::
          {:ok, [{String.t(), String.t()}], running? :: boolean()} | {:error, Error.t()}
  def list_streams(%__MODULE__{uses: uses, pid: pid}) do
    case :ets.lookup(uses, :streams) do
      [{:streams, until, streams, running?}] ->
        if monotonic_ms() < until,
          do: {:ok, streams, running?},
          else: GenServer.call(pid, :streams)

      [] ->
        GenServer.call(pid, :streams)
    end
  rescue
    ArgumentError -> gone_error()
  catch
    :exit, _ -> gone_error()
  end

  @doc "Returns the pipeline's current graph and statistics."
  @spec fetch_snapshot(t()) :: {:ok, Situ.Diagnostics.Snapshot.t()} | {:error, Error.t()}
  def fetch_snapshot(%__MODULE__{pid: pid}) do
    GenServer.call(pid, :snapshot)
  catch
    :exit, _ -> gone_error()
  end

  @doc "Returns the path through the pipeline of the message with an originating time (`Situ.trace/2`)."
  @spec trace_message(t(), Situ.Time.t()) ::
          {:ok, Situ.Diagnostics.Trace.t()} | {:error, Error.t()}
  def trace_message(%__MODULE__{pid: pid}, time) do
    GenServer.call(pid, {:trace, time})
  catch
    :exit, _ -> gone_error()
  end

  @doc "Returns the time of the pipeline's clock, or the wall-clock time if the pipeline has ended."
  @spec now(t()) :: Situ.Time.t()
  def now(%__MODULE__{pid: pid}) do
    GenServer.call(pid, :now)
  catch
    :exit, _ -> Situ.Time.now()
  end

  defp gone_error, do: {:error, Error.new(:gone, "the pipeline is no longer watched")}

  @impl true
  def init(target) do
    uses = :ets.new(__MODULE__, [:set, :public, read_concurrency: true])
    history = History.new(seconds: @seconds)
    Process.send_after(self(), :sweep, @sweep_ms)
    state = %{target: target, history: history, uses: uses, taps: %{}, streams: []}
    {:ok, Map.merge(state, %{ran: monotonic_ms(), away: monotonic_ms()})}
  end

  @impl true
  def handle_call(:handle, _from, state) do
    {:reply, %__MODULE__{pid: self(), history: state.history, uses: state.uses}, state}
  end

  def handle_call({:tap, stream}, _from, state) when is_map_key(state.taps, stream),
    do: {:reply, :ok, state}

  # Pages repeat a request many times a second, so a failed target is retried only after a delay.
  def handle_call({:tap, stream}, _from, state) do
    if monotonic_ms() < state.away do
      {:reply, {:error, ended_error()}, state}
    else
      {answer, state} = start_tap(state, stream)
      {:reply, answer, state}
    end
  end

  def handle_call(:now, _from, state), do: {:reply, pipeline_now(state.target), state}

  def handle_call(:streams, _from, state) do
    {found, state} = refresh_outputs(state)

    {streams, running?, state} =
      case found do
        {:ok, streams} -> {streams, true, %{state | ran: monotonic_ms()}}
        :ended -> {state.streams, may_return?(state), state}
      end

    :ets.insert(state.uses, {:streams, monotonic_ms() + @look_ms, streams, running?})
    {:reply, {:ok, streams, running?}, %{state | streams: streams}}
  end

  def handle_call(:snapshot, _from, state), do: {:reply, fetch_info(state.target), state}

  def handle_call({:trace, time}, _from, state) do
    answer =
      try do
        {:ok, call_pipeline(resolve_target(state.target), Situ, :trace, [time])}
      rescue
        error in Error -> {:error, error}
      catch
        _, _ -> {:error, ended_error()}
      end

    {:reply, answer, state}
  end

  @impl true
  def handle_info(:sweep, state) do
    Process.send_after(self(), :sweep, @sweep_ms)
    old = monotonic_ms() - @idle_ms

    idle =
      for {stream, _} <- state.taps,
          [{_, used}] <- [:ets.lookup(state.uses, stream)],
          used < old do
        History.mark_gap(state.history, stream, History.last_time(state.history, stream))
        stream
      end

    {:noreply, remove_taps(state, idle)}
  end

  # The replacement pipeline is tapped when a page requests the stream again.
  def handle_info({:DOWN, _, :process, pipeline, _}, state),
    do: {:noreply, remove_taps(state, list_tapped(state, &(&1 == pipeline)))}

  def handle_info(_, state), do: {:noreply, state}

  defp monotonic_ms, do: System.monotonic_time(:millisecond)

  # Returns the current streams. Removes taps on a pipeline that was replaced: its node may be suspended while the
  # part is running on another node.
  defp refresh_outputs(%{target: target} = state) do
    case resolve_target(target) do
      pid when is_function(target, 0) and is_pid(pid) ->
        {fetch_outputs(pid), remove_taps(state, list_tapped(state, &(&1 != pid)))}

      target ->
        {fetch_outputs(target), state}
    end
  end

  defp may_return?(%{target: target, ran: ran}),
    do: is_function(target, 0) and monotonic_ms() < ran + @return_ms

  defp start_tap(%{history: history} = state, stream) do
    keep = fn message ->
      History.put(history, stream, message, History.estimate_size(message.data))
    end

    last = History.last_time(history, stream)

    case attach_tap(state.target, stream, keep) do
      {:ok, tap} ->
        # The time since the stream was last tapped is unknown.
        History.mark_gap(history, stream, last)
        :ets.insert(state.uses, {stream, monotonic_ms()})
        {:ok, put_in(state.taps[stream], {tap, Process.monitor(tap.pipeline)})}

      {:error, %{code: :not_running} = error} ->
        {{:error, error}, %{state | away: monotonic_ms() + @look_ms}}

      {:error, error} ->
        {{:error, error}, state}
    end
  end

  defp list_tapped(state, which?),
    do: for({stream, {tap, _}} <- state.taps, which?.(tap.pipeline), do: stream)

  defp remove_taps(state, streams) do
    {gone, taps} = Map.split(state.taps, streams)

    for {stream, {tap, monitor}} <- gone do
      :ets.delete(state.uses, stream)
      Process.demonitor(monitor, [:flush])
      detach_tap(tap)
    end

    %{state | taps: taps}
  end

  # A pipeline may end at any time, so attaching and detaching may exit.
  defp attach_tap(target, stream, keep) do
    Situ.attach_tap({resolve_target(target), stream}, keep, name: "Studio: " <> stream)
  catch
    :exit, _ -> {:error, ended_error()}
  end

  # A remote tap is detached in a task, so that the watcher never waits for another node.
  defp detach_tap(%{pipeline: pid} = tap) when node(pid) != node(),
    do: Task.start(fn -> detach_ignoring_exit(tap) end)

  defp detach_tap(tap), do: detach_ignoring_exit(tap)

  defp detach_ignoring_exit(tap) do
    Situ.detach_tap(tap)
  catch
    :exit, _ -> :ok
  end

  defp fetch_outputs(target) do
    case fetch_info(target) do
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

  defp fetch_info(target) do
    {:ok, call_pipeline(resolve_target(target), Situ.Pipeline, :info, [])}
  rescue
    error in Error -> {:error, error}
  catch
    _, _ -> {:error, ended_error()}
  end

  defp ended_error, do: Error.new(:not_running, "the pipeline has ended")

  defp pipeline_now(target) do
    call_pipeline(resolve_target(target), Situ.Pipeline, :now, [])
  rescue
    Error -> Situ.Time.now()
  catch
    _, _ -> Situ.Time.now()
  end

  defp call_pipeline(pid, module, function, args) when is_pid(pid) and node(pid) != node(),
    do: :erpc.call(node(pid), module, function, [pid | args], @answer_ms)

  defp call_pipeline(target, module, function, args), do: apply(module, function, [target | args])

  # The process that the function calls may also have exited.
  @doc false
  def resolve_target(fun) when is_function(fun, 0) do
    fun.()
  catch
    _, _ -> nil
  end

  def resolve_target(target), do: target
end
