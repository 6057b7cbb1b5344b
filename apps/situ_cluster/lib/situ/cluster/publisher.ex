defmodule Situ.Cluster.Publisher do
  @moduledoc false
  # Publishes a part's outputs to the log and to the parts that read them. Every running part has one publisher
  # process on its node. For readers it is a GenStage producer. A slow reader gets the missing messages from the log.
  #
  # The publisher begins by taking over the part: it fences every stream, takes over the checkpoints, and
  # publishes the messages that the last checkpoint contains and the log does not. Its log writer then writes all later
  # messages to the log, so readers do not wait for the log. A refused write ends both processes, because
  # another node has taken over. See docs/adr/0112-a-lease-decides-which-node-runs-a-part.md and
  # docs/adr/0117-readers-do-not-wait-for-the-log.md.
  #
  # There are two modes. With `:outbox`, outputs become visible only when a checkpoint contains them. With `:replay`
  # (deterministic parts), outputs are visible immediately and are written to the log later; a restarted part produces
  # the same outputs again. A direct stream is visible immediately in both modes, and is not written.
  use GenServer

  alias Situ.Cluster.{
    MessageBatch,
    Checkpoint,
    OutgoingStream,
    Subscribers,
    LogWriter,
    Takeover
  }

  alias Situ.Error

  @flush_ms 5
  @trim_ms 1_000
  # While components wait to publish, this is how often the publisher checks whether they must still wait.
  @check_ms 20
  # For this time after its start, a part waits for its readers, so that they receive its first messages directly from
  # it. The messages of a direct stream are not available anywhere else.
  @join_ms 1_000
  @join_direct_ms 5_000

  defstruct [
    :log,
    :part,
    :epoch,
    :mode,
    :writer,
    :memories,
    :runner,
    :retain,
    :started_ms,
    streams: %{},
    reader_parts: %{},
    readers: %Subscribers{},
    outputs: nil,
    hidden: %{},
    flush_timer: nil,
    check_timer: nil,
    callers: [],
    full_reported?: false
  ]

  @doc "Starts a publisher that takes over the part and publishes its outputs."
  @spec start_link(map()) :: {:ok, pid()} | {:error, term()}
  def start_link(args), do: GenServer.start_link(__MODULE__, args)

  @doc "Returns the component states that the part resumes from, `nil` for none, or `:done` if the part has ended."
  @spec saved_memories(pid()) :: map() | nil | :done
  def saved_memories(publisher), do: GenServer.call(publisher, :resume, :infinity)

  @doc "Publishes messages of a stream; returns when there is room for more."
  @spec publish_messages(pid(), String.t(), [Situ.Message.t()]) :: :ok
  def publish_messages(publisher, stream, messages),
    do: GenServer.call(publisher, {:publish, stream, messages}, :infinity)

  @doc "Closes a stream."
  @spec close_stream(pid(), String.t(), Situ.Time.t()) :: :ok
  def close_stream(publisher, stream, time),
    do: GenServer.call(publisher, {:close, stream, time}, :infinity)

  @doc "Assigns all outputs published so far to the next checkpoint. Must be called while the part is paused."
  @spec begin_checkpoint(pid()) :: :ok
  def begin_checkpoint(publisher), do: GenServer.call(publisher, :cut, :infinity)

  @doc "Stores the checkpoint and the outputs that belong to it."
  @spec commit_checkpoint(pid(), map() | :done) :: :ok
  def commit_checkpoint(publisher, memories),
    do: GenServer.call(publisher, {:commit, memories}, :infinity)

  @doc "Returns the state of the streams and readers, for display."
  @spec stream_info(pid()) :: map()
  def stream_info(publisher), do: GenServer.call(publisher, :info)

  @impl true
  def init(args) do
    state = %__MODULE__{
      log: args.log,
      part: args.part,
      epoch: args.epoch,
      mode: args.mode,
      runner: args.runner,
      retain: args.retain,
      started_ms: System.monotonic_time(:millisecond),
      reader_parts: Map.new(args.streams, &{&1.name, &1.readers}),
      streams: Map.new(args.streams, &{&1.name, OutgoingStream.new(&1.name, args.deployment, &1)})
    }

    case Takeover.take_over_part(args, state.streams) do
      {:ok, streams, checkpoint} ->
        if state.retain != :all, do: Process.send_after(self(), :trim, @trim_ms)
        {:ok, writer} = Takeover.start_writer(args, streams, checkpoint)
        memories = Checkpoint.saved_memories(checkpoint)
        state = %{state | streams: streams, writer: writer, memories: memories}
        {:ok, publish_pending(state, checkpoint)}

      {:error, error} ->
        {:stop, {:shutdown, error}}
    end
  end

  # Publishes the messages that the checkpoint contains and the log does not.
  defp publish_pending(state, %{current: nil}), do: state

  defp publish_pending(state, %{current: %{pending: pending}}) do
    Enum.reduce(pending, state, fn {name, {batches, mark}}, state ->
      stream = Map.fetch!(state.streams, name)

      if stream.stored_mark != mark and mark.last >= stream.stored_mark.last do
        batches = for b <- batches, b = MessageBatch.take_after(b, stream.stored_mark.last), do: b
        :ok = LogWriter.append_batches(state.writer, name, batches, mark)

        state
        |> put_stream(%{stream | mark: mark, handed_mark: mark, writing?: true})
        |> defer_batches(name, batches)
      else
        state
      end
    end)
  end

  # Readers see the batches once the log contains them.
  defp defer_batches(state, _name, []), do: state

  defp defer_batches(state, name, batches),
    do: %{state | hidden: Map.update(state.hidden, name, batches, &(&1 ++ batches))}

  @impl true
  def handle_call(:resume, _from, state), do: {:reply, state.memories, state}

  def handle_call({:publish, name, messages}, from, state) do
    {batch, stream} = state.streams |> Map.fetch!(name) |> OutgoingStream.add_messages(messages)
    state = put_stream(state, stream)

    cond do
      batch == nil ->
        {:reply, :ok, state}

      stream.direct ->
        state |> offer_batch(name, batch) |> reply_or_wait(from, name)

      state.mode == :replay ->
        state |> show_batch(name, batch) |> schedule_flush() |> reply_or_wait(from, name)

      true ->
        {:reply, :ok, request_checkpoint(state)}
    end
  end

  def handle_call({:close, name, time}, _from, state) do
    state = put_stream(state, OutgoingStream.close(Map.fetch!(state.streams, name), time))
    {:reply, :ok, if(state.mode == :replay, do: flush_streams(state), else: state)}
  end

  def handle_call(:cut, _from, state), do: {:reply, :ok, collect_outputs(state)}

  def handle_call({:commit, memories}, from, state) do
    state = if state.outputs == nil or memories == :done, do: collect_outputs(state), else: state
    :ok = LogWriter.commit_checkpoint(state.writer, memories, state.outputs, from)

    state =
      Enum.reduce(state.outputs, state, fn {name, {batches, _}}, state ->
        defer_batches(state, name, batches)
      end)

    {:noreply, %{state | outputs: nil}}
  end

  def handle_call(:info, _from, state) do
    streams =
      Map.new(state.streams, fn {name, stream} ->
        mark = if stream.direct, do: stream.mark, else: stream.stored_mark

        {name,
         %{messages: mark.last, time: mark.time, closed: mark.closing, direct: stream.direct}}
      end)

    {:reply,
     %{streams: streams, readers: Subscribers.reader_positions(state.readers), mode: state.mode},
     state}
  end

  # Applies back-pressure: a component that publishes waits while the log or an active reader cannot keep up.
  defp reply_or_wait(state, from, name) do
    if must_wait?(state, name),
      do: {:noreply, schedule_check(%{state | callers: [{from, name} | state.callers]})},
      else: {:reply, :ok, state}
  end

  defp must_wait?(state, name) do
    stream = state.streams[name]

    OutgoingStream.full?(stream) or not Subscribers.keeping_up?(state.readers, stream) or
      (just_started?(state, stream) and
         not Subscribers.all_joined?(state.readers, stream, awaited_parts(state, stream)))
  end

  # A part that may lose messages may also lose the first ones, so it is not awaited.
  defp awaited_parts(state, stream),
    do: Enum.reject(state.reader_parts[stream.name], &is_map_key(stream.policies, &1))

  defp just_started?(state, stream) do
    age = System.monotonic_time(:millisecond) - state.started_ms
    age < if(stream.direct, do: @join_direct_ms, else: @join_ms)
  end

  defp release_waiting(%{callers: []} = state), do: state

  defp release_waiting(state) do
    {blocked, released} =
      Enum.split_with(state.callers, fn {_, name} -> must_wait?(state, name) end)

    for {from, _} <- released, do: GenServer.reply(from, :ok)
    %{state | callers: blocked}
  end

  defp schedule_check(%{check_timer: nil} = state),
    do: %{state | check_timer: Process.send_after(self(), :check, @check_ms)}

  defp schedule_check(state), do: state

  # The outputs of a deterministic part are written after a short delay.
  defp schedule_flush(%{flush_timer: nil} = state),
    do: %{state | flush_timer: Process.send_after(self(), :flush, @flush_ms)}

  defp schedule_flush(state), do: state

  # Requests a checkpoint before the regular one, because too many messages are pending.
  defp request_checkpoint(%{full_reported?: false} = state) do
    if Enum.any?(state.streams, fn {_, stream} -> OutgoingStream.full?(stream) end) do
      send(state.runner, :situ_full)
      %{state | full_reported?: true}
    else
      state
    end
  end

  defp request_checkpoint(state), do: state

  defp flush_streams(state) do
    Enum.reduce(state.streams, %{state | flush_timer: nil}, fn {name, stream}, state ->
      # While a batch is being written, more batches accumulate for the next write.
      if stream.writing?, do: state, else: hand_over(state, name)
    end)
  end

  defp hand_over(state, name) do
    stream = state.streams[name]

    if OutgoingStream.pending?(stream) do
      {{batches, mark}, stream} = OutgoingStream.take_pending(stream)
      :ok = LogWriter.append_batches(state.writer, name, batches, mark)
      put_stream(state, stream)
    else
      state
    end
  end

  defp collect_outputs(%{mode: :replay} = state) do
    state = state.streams |> Map.keys() |> Enum.reduce(state, &hand_over(&2, &1))
    %{state | outputs: %{}}
  end

  # Messages left from an earlier cut are older, so they go first.
  defp collect_outputs(%{mode: :outbox} = state) do
    {outputs, streams} =
      for {name, stream} <- state.streams,
          OutgoingStream.pending?(stream),
          reduce: {%{}, state.streams} do
        {outputs, streams} ->
          {pending, stream} = OutgoingStream.take_pending(stream)
          {Map.put(outputs, name, pending), Map.put(streams, name, stream)}
      end

    outputs =
      Map.merge(state.outputs || %{}, outputs, fn _, {older, _}, {batches, mark} ->
        {older ++ batches, mark}
      end)

    %{state | outputs: outputs, streams: streams, full_reported?: false}
  end

  defp handle_stored(state, name, mark, seq) do
    state = put_stream(state, OutgoingStream.note_stored(state.streams[name], mark, seq))
    {batches, hidden} = Map.pop(state.hidden, name, [])
    {visible, rest} = Enum.split_while(batches, &(&1.last <= mark.last))
    state = %{state | hidden: if(rest == [], do: hidden, else: Map.put(hidden, name, rest))}
    Enum.reduce(visible, state, &show_batch(&2, name, &1))
  end

  # The batch is kept only if some reader must not lose messages.
  defp offer_batch(state, name, batch) do
    stream = state.streams[name]
    state = %{state | readers: Subscribers.offer_batch(state.readers, stream, batch)}
    all_lossy? = Enum.all?(state.reader_parts[name], &is_map_key(stream.policies, &1))
    if all_lossy?, do: state, else: show_batch(state, name, batch)
  end

  defp show_batch(state, name, batch),
    do:
      state
      |> put_stream(OutgoingStream.make_visible(state.streams[name], batch))
      |> serve_readers(name)

  defp serve_readers(state, name),
    do: %{
      state
      | readers: Subscribers.serve_stream(state.readers, state.streams[name], state.log)
    }

  # The following functions serve readers.

  @impl true
  def handle_info({:"$gen_producer", {pid, ref}, {:subscribe, _, opts}}, state)
      when is_pid(pid) and is_list(opts) do
    name = opts[:stream]

    if is_map_key(state.streams, name) do
      readers = Subscribers.add_reader(state.readers, pid, ref, state.streams[name], opts)
      {:noreply, %{state | readers: readers} |> serve_readers(name) |> release_waiting()}
    else
      error = Error.new(:unknown_stream, "part #{state.part} does not publish #{inspect(name)}")
      send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, error}})
      {:noreply, state}
    end
  end

  def handle_info({:"$gen_producer", {_pid, ref}, {:ask, n}}, state)
      when is_integer(n) and n > 0 do
    case Subscribers.add_demand(state.readers, ref, n) do
      {:ok, name, readers} ->
        {:noreply, %{state | readers: readers} |> serve_readers(name) |> release_waiting()}

      :error ->
        {:noreply, state}
    end
  end

  def handle_info({:"$gen_producer", {pid, ref}, {:cancel, _reason}}, state) do
    send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, :normal}})
    {:noreply, release_waiting(%{state | readers: Subscribers.remove_reader(state.readers, ref)})}
  end

  def handle_info({:DOWN, monitor, :process, _, _}, state),
    do:
      {:noreply,
       release_waiting(%{state | readers: Subscribers.remove_ended(state.readers, monitor)})}

  def handle_info({:situ_stored, name, mark, seq}, state) do
    state = state |> handle_stored(name, mark, seq) |> serve_readers(name)
    more? = state.mode == :replay and OutgoingStream.pending?(state.streams[name])
    {:noreply, release_waiting(if(more?, do: schedule_flush(state), else: state))}
  end

  def handle_info(:flush, state), do: {:noreply, flush_streams(state)}

  def handle_info(:check, state) do
    state = release_waiting(%{state | check_timer: nil})
    {:noreply, if(state.callers == [], do: state, else: schedule_check(state))}
  end

  def handle_info(:trim, state) do
    for {_, stream} <- state.streams,
        not stream.direct,
        do: OutgoingStream.trim_log(stream, state.log, state.retain)

    Process.send_after(self(), :trim, @trim_ms)
    {:noreply, state}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp put_stream(state, stream),
    do: %{state | streams: Map.put(state.streams, stream.name, stream)}

  @impl true
  def format_status(_reason, [_dictionary, state]),
    do: [data: [{~c"State", %{part: state.part, epoch: state.epoch, mode: state.mode}}]]
end
