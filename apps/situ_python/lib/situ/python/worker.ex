defmodule Situ.Python.Worker do
  @moduledoc false
  # The process that owns the Python program of one component, its socket and its shared memory. It is linked to the
  # component, so both end together, and the program ends with this process in any case (`Situ.Python.Program`).
  #
  # The component receives `{:situ_python, worker, event}`:
  #
  #   * `{:ready, process, version}`: messages can be sent;
  #   * `{:results, results, ns}`: the results of the oldest messages, in order (`Situ.Python.Results`), and the time
  #     that Python has spent on them;
  #   * `{:closed, result}`: the result of `on_close`;
  #   * `{:reply, ref, result}`: the reply to a request, after the results of all messages before it;
  #   * `{:ended, error}`: the program has ended, and nothing follows.
  #
  # Two frames are in flight, so the program has work while it sends results. Messages that arrive in the meantime are
  # sent together in the next frame, so frames grow with the load.
  use GenServer, restart: :temporary

  alias Situ.{Error, TempFolder}
  alias Situ.Python.{Connection, LogLines, Program, Protocol, Results, SharedMemory, WorkerErrors}
  require Logger

  # Values of this size or larger go through shared memory.
  @large 65_536
  @frame_bytes 262_144
  # The program has this long to end by itself after its socket has closed, and its last results to arrive, ms.
  @exit_timeout 1_000
  @frames_in_flight 2

  @type config :: %{
          path: String.t(),
          interpreter: Path.t(),
          start: map(),
          outputs: keyword(Situ.Type.t()),
          timeout: timeout(),
          shared_memory: pos_integer()
        }

  defstruct [
    :owner,
    :config,
    :folder,
    :port,
    :listener,
    :socket,
    :memory,
    :timer,
    :ending,
    phase: :starting,
    lines: %LogLines{},
    waiting: :queue.new(),
    batch: [],
    batch_bytes: 0,
    frames: :queue.new(),
    in_flight: 0,
    received: 0,
    requests: :queue.new(),
    progress: 0
  ]

  @doc "Starts the program; the calling process is the component. Returns an error if the system lacks resources."
  @spec start_link(config()) :: {:ok, pid()} | {:error, term()}
  def start_link(config), do: GenServer.start_link(__MODULE__, {self(), config})

  @doc "Sends messages: for each, the fields before the place, and the encoded value."
  @spec send_messages(pid(), [{binary(), iodata()}]) :: :ok
  def send_messages(worker, messages), do: GenServer.cast(worker, {:messages, messages})

  @doc "Announces that all inputs have closed."
  @spec send_close(pid(), Situ.Time.t()) :: :ok
  def send_close(worker, time), do: GenServer.cast(worker, {:close, time})

  @doc "Sends a request: the frame `Situ.Python.Protocol.encode_snapshot/0` or `Situ.Python.Protocol.encode_restore/1`."
  @spec send_request(pid(), reference(), iodata()) :: :ok
  def send_request(worker, ref, frame), do: GenServer.cast(worker, {:request, ref, frame})

  @doc "Ends the program. It has a second to end by itself."
  @spec stop(pid()) :: :ok
  def stop(worker) do
    GenServer.stop(worker, :normal, 5 * @exit_timeout)
  catch
    :exit, _ -> :ok
  end

  @impl true
  def init({owner, config}) do
    Process.flag(:trap_exit, true)
    {:ok, %__MODULE__{owner: owner, config: config}, {:continue, :open}}
  end

  @impl true
  def handle_continue(:open, state) do
    with {:ok, folder} <- SharedMemory.create_folder(),
         state = %{state | folder: folder},
         {:ok, memory} <- SharedMemory.create_files(folder, state.config.shared_memory),
         {:ok, listener} <- Connection.listen(Program.socket_path(folder)) do
      port = Program.start_worker(state.config.interpreter, folder)
      {:noreply, %{state | memory: memory, listener: listener, port: port}}
    else
      {:error, %Error{} = error} ->
        fail(state, error)

      {:error, reason} ->
        fail(state, WorkerErrors.start_error(inspect(reason)))
    end
  end

  @impl true
  def handle_cast({:messages, messages}, state) do
    waiting =
      Enum.reduce(messages, state.waiting, fn {head, value}, waiting ->
        :queue.in({head, value, IO.iodata_length(value)}, waiting)
      end)

    %{state | waiting: waiting} |> fill_batch() |> continue()
  end

  # `on_close` follows all messages.
  def handle_cast({:close, time}, state) do
    state = %{state | waiting: :queue.in({:close, time}, state.waiting)}
    state |> fill_batch() |> continue()
  end

  def handle_cast({:request, ref, frame}, state) do
    state = %{
      state
      | waiting: :queue.in({:request, frame}, state.waiting),
        requests: :queue.in(ref, state.requests)
    }

    state |> fill_batch() |> continue()
  end

  # The batch is sent when no more messages wait in the mailbox.
  @impl true
  def handle_info(:timeout, state), do: {:noreply, send_batch(state)}

  def handle_info({:accepted, socket}, state) do
    :gen_tcp.close(state.listener)
    start = Map.put(state.config.start, "folder", state.folder)
    state = %{state | socket: socket, listener: nil}

    case Protocol.encode_start(start) do
      {:ok, frame} ->
        :ok = Connection.activate(socket)
        send_frame(state, frame)
        continue(state)

      :error ->
        fail(state, WorkerErrors.option_error())
    end
  end

  def handle_info({:tcp, socket, bytes}, %{socket: socket} = state) do
    case Protocol.decode_frame(bytes) do
      {:ok, frame} -> handle_frame(frame, state)
      :error -> fail(state, WorkerErrors.protocol_error())
    end
  end

  def handle_info({:tcp_closed, socket}, %{socket: socket} = state),
    do: expect_end(%{state | socket: nil})

  def handle_info({port, {:data, {_end, line}}}, %{port: port} = state),
    do: state |> log_line(line) |> continue()

  def handle_info({port, {:exit_status, status}}, %{port: port} = state),
    do: expect_end(%{state | port: nil, ending: Program.describe_status(status)})

  def handle_info(:exit_timeout, state), do: fail(report_journal(state), ended_error(state))

  def handle_info({:check_progress, token}, %{timer: token} = state),
    do: check_progress(%{state | timer: nil})

  def handle_info({:EXIT, owner, reason}, %{owner: owner} = state), do: {:stop, reason, state}
  def handle_info(_other, state), do: continue(state)

  defp log_line(state, line) do
    {entries, lines} = LogLines.add_line(state.lines, line, System.monotonic_time(:millisecond))
    for {level, text} <- entries, do: Logger.log(level, [state.config.path, ": ", text])
    %{state | lines: lines}
  end

  # The program has ended when its exit status is known and everything that it has sent was read.
  defp expect_end(%{port: nil, socket: nil} = state),
    do: fail(report_journal(state), ended_error(state))

  defp expect_end(state) do
    if state.phase != :ending, do: Process.send_after(self(), :exit_timeout, @exit_timeout)
    continue(%{state | phase: :ending})
  end

  defp ended_error(state),
    do: WorkerErrors.ended_error(state.ending, LogLines.last_lines(state.lines))

  # The last results of the program. Most of them have arrived, but those in a connection that was reset have not.
  defp report_journal(state) do
    with {sent, <<_, _::binary>> = bytes} when sent <= state.received <-
           SharedMemory.read_journal(state.memory),
         {:ok, results} <- Protocol.decode_results(bytes),
         [_ | _] = results when length(results) <= state.in_flight <-
           Enum.drop(results, state.received - sent) do
      {converted, _slots} = convert_results(results, state)
      report(state, {:results, converted, 0})
      state
    else
      _ -> state
    end
  end

  defp handle_frame({:ready, process, version}, %{phase: :starting} = state) do
    # Both sides have opened everything in the folder.
    TempFolder.remove_folder(state.folder)
    report(state, {:ready, process, to_string(version)})
    %{state | phase: :running, folder: nil} |> fill_batch() |> continue()
  end

  defp handle_frame({:not_started, term}, %{phase: :starting} = state),
    do: fail(state, WorkerErrors.not_started_error(term))

  defp handle_frame({:results, results, spent_ns}, state)
       when length(results) <= state.in_flight do
    {converted, slots} = convert_results(results, state)
    report(state, {:results, converted, spent_ns})
    return_slots(state, slots)

    state
    |> Map.update!(:in_flight, &(&1 - length(results)))
    |> Map.update!(:received, &(&1 + length(results)))
    |> drop_handled_frames()
    |> record_progress()
    |> fill_batch()
    |> continue()
  end

  defp handle_frame({:returned, slots}, state) do
    case SharedMemory.free_slots(state.memory, slots) do
      {:ok, memory} -> %{state | memory: memory} |> fill_batch() |> continue()
      :error -> fail(state, WorkerErrors.protocol_error())
    end
  end

  defp handle_frame({:closed, result}, state) do
    {converted, _slots} = Results.convert_result(result, state.config.outputs, state.memory)
    report(state, {:closed, converted})
    continue(%{state | in_flight: 0})
  end

  defp handle_frame({:reply, result}, state) do
    case :queue.out(state.requests) do
      {{:value, ref}, requests} ->
        report(state, {:reply, ref, Results.read_reply(result, state.memory)})
        continue(%{state | requests: requests, in_flight: state.in_flight - 1})

      {:empty, _} ->
        fail(state, WorkerErrors.protocol_error())
    end
  end

  defp handle_frame(_frame, state), do: fail(state, WorkerErrors.protocol_error())

  defp return_slots(state, slots) do
    free = slots ++ SharedMemory.take_released(state.memory)
    if free != [], do: send_frame(state, Protocol.encode_return(free))
  end

  defp convert_results(results, state) do
    {converted, slots} =
      results
      |> Enum.map(&Results.convert_result(&1, state.config.outputs, state.memory))
      |> Enum.unzip()

    {converted, Enum.concat(slots)}
  end

  # Moves waiting messages to the batch, until one needs shared memory that is in use.
  defp fill_batch(%{phase: :running} = state) do
    case :queue.peek(state.waiting) do
      :empty -> state
      {:value, {:close, time}} -> state |> send_batch() |> send_last(Protocol.encode_close(time))
      {:value, {:request, frame}} -> state |> send_batch() |> send_last(frame)
      {:value, message} -> place_message(state, message)
    end
  end

  defp fill_batch(state), do: state

  # The component waits for the reply before it sends more.
  defp send_last(state, frame) do
    send_frame(state, frame)
    state = %{state | waiting: :queue.drop(state.waiting), in_flight: state.in_flight + 1}
    record_progress(state)
  end

  defp place_message(state, {head, value, length}) when length < @large,
    do: add_to_batch(state, head, {:bytes, value}, length)

  defp place_message(state, {head, value, length}) do
    case SharedMemory.write_value(state.memory, value, length) do
      {:ok, slot, memory} -> add_to_batch(%{state | memory: memory}, head, {:slot, slot}, 0)
      :full when state.in_flight > 0 or state.batch != [] -> send_batch(state)
      :full -> add_to_batch(state, head, {:bytes, value}, length)
    end
  end

  defp add_to_batch(state, head, place, length) do
    state = %{
      state
      | waiting: :queue.drop(state.waiting),
        batch: [state.batch, head, Protocol.encode_place(place)],
        batch_bytes: state.batch_bytes + length,
        in_flight: state.in_flight + 1
    }

    state = if state.in_flight == 1, do: record_progress(state), else: state
    fill_batch(if state.batch_bytes > @frame_bytes, do: send_batch(state), else: state)
  end

  defp send_batch(%{batch: []} = state), do: state

  defp send_batch(state) do
    send_frame(state, Protocol.encode_messages(state.batch))
    # A frame has been handled when this many results have arrived.
    frames = :queue.in(state.received + state.in_flight, state.frames)
    %{state | batch: [], batch_bytes: 0, frames: frames}
  end

  defp send_frame(state, frame), do: Connection.send_frame(state.socket, frame)

  defp drop_handled_frames(%{received: received} = state) do
    case :queue.peek(state.frames) do
      {:value, last} when last <= received ->
        drop_handled_frames(%{state | frames: :queue.drop(state.frames)})

      _ ->
        state
    end
  end

  defp continue(%{batch: []} = state), do: {:noreply, state}

  defp continue(state) do
    if :queue.len(state.frames) < @frames_in_flight,
      do: {:noreply, state, 0},
      else: {:noreply, state}
  end

  # One timer is enough: when it is due, it is set again for the rest of the time.
  defp record_progress(%{config: %{timeout: :infinity}} = state), do: state

  defp record_progress(state),
    do: set_timer(%{state | progress: System.monotonic_time(:millisecond)}, state.config.timeout)

  defp set_timer(%{timer: nil, in_flight: n} = state, ms) when n > 0 do
    token = make_ref()
    Process.send_after(self(), {:check_progress, token}, ms)
    %{state | timer: token}
  end

  defp set_timer(state, _ms), do: state

  defp check_progress(%{in_flight: 0} = state), do: continue(state)

  defp check_progress(state) do
    left = state.progress + state.config.timeout - System.monotonic_time(:millisecond)

    # The program sends results together, so there may be some of messages before this one.
    if left > 0,
      do: continue(set_timer(state, left)),
      else: fail(report_journal(state), WorkerErrors.late_error(state.config.timeout))
  end

  defp fail(state, error) do
    report(state, {:ended, error})
    {:stop, :normal, %{state | phase: :failed}}
  end

  defp report(state, event), do: send(state.owner, {:situ_python, self(), event})

  @impl true
  def terminate(_reason, state) do
    if state.socket, do: :gen_tcp.close(state.socket)
    if state.phase == :running, do: await_exit(state)
    if state.port, do: close_port(state.port)
    if state.memory, do: SharedMemory.close_files(state.memory)
    if state.folder, do: TempFolder.remove_folder(state.folder)
  end

  # The program may still print.
  defp await_exit(%{port: port} = state) do
    receive do
      {^port, {:data, {_end, line}}} -> state |> log_line(line) |> await_exit()
      {^port, {:exit_status, _}} -> :ok
    after
      @exit_timeout -> :ok
    end
  end

  # Closing the port kills the program.
  defp close_port(port) do
    Port.close(port)
  rescue
    ArgumentError -> true
  end
end
