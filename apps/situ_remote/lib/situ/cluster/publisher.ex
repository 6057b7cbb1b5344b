defmodule Situ.Cluster.Publisher do
  @moduledoc false
  # Publishes a part's outputs to the log and to the parts that read them. Every running part has one publisher
  # process on its node. For readers it is a GenStage producer. A slow reader gets the missing messages from the log.
  #
  # The publisher begins by taking over the part (ADR 0112): it fences every stream, takes over the checkpoints, and
  # publishes the messages that the last checkpoint contains and the log does not. Its scribe then writes all later
  # messages to the log (ADR 0117), so readers do not wait for the log. A refused write ends both processes, because
  # another node has taken over.
  #
  # There are two modes. With `:outbox`, outputs become visible only when a checkpoint contains them. With `:replay`
  # (deterministic parts), outputs are visible immediately and are written to the log later; a restarted part produces
  # the same outputs again. A direct stream is visible immediately in both modes, and is not written.
  use GenServer

  alias Situ.Cluster.{Batch, Checkpoint, Chunk, Outgoing, Readers, Scribe}
  alias Situ.Error
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry

  @flush_ms 5
  @trim_ms 1_000
  # While components wait to publish, this is how often the publisher checks whether they must still wait.
  @look_ms 20
  # For this time after its start, a part waits for its readers, so that they receive its first messages directly from
  # it. The messages of a direct stream are not available anywhere else.
  @join_ms 1_000
  @join_direct_ms 5_000

  defstruct [
    :log,
    :part,
    :epoch,
    :mode,
    :scribe,
    :memories,
    :runner,
    :retain,
    :since,
    streams: %{},
    parts: %{},
    readers: %Readers{},
    cut: nil,
    unshown: %{},
    writes: 0,
    timer: nil,
    looking: nil,
    waiting: [],
    told_full: false
  ]

  @doc "Starts a publisher that takes over the part and publishes its outputs."
  @spec start_link(map()) :: {:ok, pid()} | {:error, term()}
  def start_link(args), do: GenServer.start_link(__MODULE__, args)

  @doc "Returns the memories that the part continues from, `nil` for none, or `:done` if the part has ended."
  @spec resume(pid()) :: map() | nil | :done
  def resume(publisher), do: GenServer.call(publisher, :resume, :infinity)

  @doc "Publishes messages of a stream; returns when there is room for more."
  @spec publish(pid(), String.t(), [Situ.Message.t()]) :: :ok
  def publish(publisher, stream, messages),
    do: GenServer.call(publisher, {:publish, stream, messages}, :infinity)

  @doc "Closes a stream."
  @spec close(pid(), String.t(), Situ.Time.t()) :: :ok
  def close(publisher, stream, time),
    do: GenServer.call(publisher, {:close, stream, time}, :infinity)

  @doc "Assigns all outputs published so far to the next checkpoint. Must be called while the part is paused."
  @spec cut(pid()) :: :ok
  def cut(publisher), do: GenServer.call(publisher, :cut, :infinity)

  @doc "Stores the checkpoint and the outputs that belong to it."
  @spec commit(pid(), map() | :done) :: :ok
  def commit(publisher, memories), do: GenServer.call(publisher, {:commit, memories}, :infinity)

  @doc "Returns the state of the streams and readers, for display."
  @spec info(pid()) :: map()
  def info(publisher), do: GenServer.call(publisher, :info)

  @impl true
  def init(args) do
    state = %__MODULE__{
      log: args.log,
      part: args.part,
      epoch: args.epoch,
      mode: args.mode,
      runner: args.runner,
      retain: args.retain,
      since: System.monotonic_time(:millisecond),
      parts: Map.new(args.streams, &{&1.name, &1.readers}),
      streams: Map.new(args.streams, &{&1.name, Outgoing.new(&1.name, args.deployment, &1)})
    }

    with {:ok, state} <- fence(state, Map.keys(state.streams)),
         marks = Map.new(state.streams, fn {name, out} -> {name, out.stored.last} end),
         key = "ckpt.#{args.deployment}.#{args.part}",
         {:ok, checkpoint} <- Checkpoint.take(state.log, key, state.epoch, marks) do
      if state.retain != :all, do: Process.send_after(self(), :trim, @trim_ms)
      {:ok, scribe} = scribe(state, checkpoint)
      state = %{state | scribe: scribe, memories: Checkpoint.memories(checkpoint)}
      {:ok, publish_pending(state, checkpoint)}
    else
      {:error, error} -> {:stop, {:shutdown, error}}
    end
  end

  defp scribe(state, checkpoint) do
    streams =
      Map.new(state.streams, fn {name, out} ->
        {name, %{subject: out.subject, seq: out.seq, mark: out.stored}}
      end)

    Scribe.start_link(%{
      log: state.log,
      part: state.part,
      epoch: state.epoch,
      checkpoint: checkpoint,
      streams: streams
    })
  end

  defp fence(state, []), do: {:ok, state}

  defp fence(state, [name | rest]) do
    out = state.streams[name]

    with {:ok, last} <- Log.last(state.log, out.subject) do
      mark = Chunk.mark(last)
      seq = if last, do: last.seq, else: 0
      {op, state} = op(state, name)

      case Log.append(state.log, out.subject, seq, Chunk.fence(mark, state.epoch, op)) do
        {:ok, seq} ->
          fence(put(state, Outgoing.begin(%{out | seq: seq}, mark)), rest)

        # The previous owner has written in the meantime. That is valid if its epoch is older.
        {:refused, last} ->
          if Entry.integer(last, "Epoch", 0) > state.epoch,
            do: {:error, Scribe.refused(out.subject)},
            else: fence(state, [name | rest])

        {:error, error} ->
          {:error, error}
      end
    end
  end

  # Publishes the messages that the checkpoint contains and the log does not.
  defp publish_pending(state, %{current: nil}), do: state

  defp publish_pending(state, %{current: %{pending: pending}}) do
    Enum.reduce(pending, state, fn {name, {batches, mark}}, state ->
      out = Map.fetch!(state.streams, name)

      if out.stored != mark and mark.last >= out.stored.last do
        batches = for b <- batches, b = Batch.behind(b, out.stored.last), do: b
        :ok = Scribe.append(state.scribe, name, batches, mark)
        state |> put(%{out | mark: mark, handed: mark, busy: true}) |> later(name, batches)
      else
        state
      end
    end)
  end

  # Readers see the batches once the log contains them.
  defp later(state, _name, []), do: state

  defp later(state, name, batches),
    do: %{state | unshown: Map.update(state.unshown, name, batches, &(&1 ++ batches))}

  @impl true
  def handle_call(:resume, _from, state), do: {:reply, state.memories, state}

  def handle_call({:publish, name, messages}, from, state) do
    {batch, out} = state.streams |> Map.fetch!(name) |> Outgoing.add(messages)
    state = put(state, out)

    cond do
      batch == nil -> {:reply, :ok, state}
      out.direct -> state |> offer(name, batch) |> wait_or_go(from, name)
      state.mode == :replay -> state |> show(name, batch) |> timed() |> wait_or_go(from, name)
      true -> {:reply, :ok, full(state)}
    end
  end

  def handle_call({:close, name, time}, _from, state) do
    state = put(state, Outgoing.close(Map.fetch!(state.streams, name), time))
    {:reply, :ok, if(state.mode == :replay, do: flush(state), else: state)}
  end

  def handle_call(:cut, _from, state), do: {:reply, :ok, cut_now(state)}

  def handle_call({:commit, memories}, from, state) do
    state = if state.cut == nil or memories == :done, do: cut_now(state), else: state
    :ok = Scribe.commit(state.scribe, memories, state.cut, from)

    state =
      Enum.reduce(state.cut, state, fn {name, {batches, _}}, state ->
        later(state, name, batches)
      end)

    {:noreply, %{state | cut: nil}}
  end

  def handle_call(:info, _from, state) do
    streams =
      Map.new(state.streams, fn {name, out} ->
        mark = if out.direct, do: out.mark, else: out.stored
        {name, %{messages: mark.last, time: mark.time, closed: mark.closing, direct: out.direct}}
      end)

    {:reply, %{streams: streams, readers: Readers.info(state.readers), mode: state.mode}, state}
  end

  # Applies back-pressure: a component that publishes waits while the log or an active reader cannot keep up.
  defp wait_or_go(state, from, name) do
    if hold?(state, name),
      do: {:noreply, look(%{state | waiting: [{from, name} | state.waiting]})},
      else: {:reply, :ok, state}
  end

  defp hold?(state, name) do
    out = state.streams[name]

    Outgoing.full?(out) or not Readers.keeping_up?(state.readers, out) or
      (young?(state, out) and not Readers.seen?(state.readers, out, awaited(state, out)))
  end

  # A part that may lose messages may also lose the first ones, so it is not awaited.
  defp awaited(state, out), do: Enum.reject(state.parts[out.name], &is_map_key(out.policies, &1))

  defp young?(state, out) do
    age = System.monotonic_time(:millisecond) - state.since
    age < if(out.direct, do: @join_direct_ms, else: @join_ms)
  end

  defp go(%{waiting: []} = state), do: state

  defp go(state) do
    {hold, go} = Enum.split_with(state.waiting, fn {_, name} -> hold?(state, name) end)
    for {from, _} <- go, do: GenServer.reply(from, :ok)
    %{state | waiting: hold}
  end

  defp look(%{looking: nil} = state),
    do: %{state | looking: Process.send_after(self(), :look, @look_ms)}

  defp look(state), do: state

  # The outputs of a deterministic part are written after a short delay.
  defp timed(%{timer: nil} = state),
    do: %{state | timer: Process.send_after(self(), :flush, @flush_ms)}

  defp timed(state), do: state

  # Requests a checkpoint before the regular one, because too many messages are pending.
  defp full(%{told_full: false} = state) do
    if Enum.any?(state.streams, fn {_, out} -> Outgoing.full?(out) end) do
      send(state.runner, :situ_full)
      %{state | told_full: true}
    else
      state
    end
  end

  defp full(state), do: state

  defp flush(state) do
    Enum.reduce(state.streams, %{state | timer: nil}, fn {name, out}, state ->
      # While a batch is being written, more batches accumulate for the next write.
      if out.busy, do: state, else: hand_over(state, name)
    end)
  end

  defp hand_over(state, name) do
    out = state.streams[name]

    if Outgoing.pending?(out) do
      {{batches, mark}, out} = Outgoing.take(out)
      :ok = Scribe.append(state.scribe, name, batches, mark)
      put(state, out)
    else
      state
    end
  end

  defp cut_now(%{mode: :replay} = state) do
    state = state.streams |> Map.keys() |> Enum.reduce(state, &hand_over(&2, &1))
    %{state | cut: %{}}
  end

  # Messages left from an earlier cut are older, so they go first.
  defp cut_now(%{mode: :outbox} = state) do
    {cut, streams} =
      for {name, out} <- state.streams, Outgoing.pending?(out), reduce: {%{}, state.streams} do
        {cut, streams} ->
          {taken, out} = Outgoing.take(out)
          {Map.put(cut, name, taken), Map.put(streams, name, out)}
      end

    cut =
      Map.merge(state.cut || %{}, cut, fn _, {older, _}, {batches, mark} ->
        {older ++ batches, mark}
      end)

    %{state | cut: cut, streams: streams, told_full: false}
  end

  defp stored(state, name, mark, seq) do
    state = put(state, Outgoing.stored(state.streams[name], mark, seq))
    {batches, unshown} = Map.pop(state.unshown, name, [])
    {now, later} = Enum.split_while(batches, &(&1.last <= mark.last))
    state = %{state | unshown: if(later == [], do: unshown, else: Map.put(unshown, name, later))}
    Enum.reduce(now, state, &show(&2, name, &1))
  end

  # The batch is kept only if some reader must not lose messages.
  defp offer(state, name, batch) do
    out = state.streams[name]
    state = %{state | readers: Readers.offer(state.readers, out, batch)}
    all_lossy? = Enum.all?(state.parts[name], &is_map_key(out.policies, &1))
    if all_lossy?, do: state, else: show(state, name, batch)
  end

  defp show(state, name, batch),
    do: state |> put(Outgoing.show(state.streams[name], batch)) |> serve(name)

  defp serve(state, name),
    do: %{state | readers: Readers.serve(state.readers, state.streams[name], state.log)}

  # Readers

  @impl true
  def handle_info({:"$gen_producer", {pid, ref}, {:subscribe, _, opts}}, state)
      when is_pid(pid) and is_list(opts) do
    name = opts[:stream]

    if is_map_key(state.streams, name) do
      readers = Readers.join(state.readers, pid, ref, state.streams[name], opts)
      {:noreply, %{state | readers: readers} |> serve(name) |> go()}
    else
      error = Error.new(:unknown_stream, "part #{state.part} does not publish #{inspect(name)}")
      send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, error}})
      {:noreply, state}
    end
  end

  def handle_info({:"$gen_producer", {_pid, ref}, {:ask, n}}, state)
      when is_integer(n) and n > 0 do
    case Readers.ask(state.readers, ref, n) do
      {:ok, name, readers} -> {:noreply, %{state | readers: readers} |> serve(name) |> go()}
      :error -> {:noreply, state}
    end
  end

  def handle_info({:"$gen_producer", {pid, ref}, {:cancel, _reason}}, state) do
    send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, :normal}})
    {:noreply, go(%{state | readers: Readers.leave(state.readers, ref)})}
  end

  def handle_info({:DOWN, monitor, :process, _, _}, state),
    do: {:noreply, go(%{state | readers: Readers.gone(state.readers, monitor)})}

  def handle_info({:situ_stored, name, mark, seq}, state) do
    state = state |> stored(name, mark, seq) |> serve(name)
    more? = state.mode == :replay and Outgoing.pending?(state.streams[name])
    {:noreply, go(if(more?, do: timed(state), else: state))}
  end

  def handle_info(:flush, state), do: {:noreply, flush(state)}

  def handle_info(:look, state) do
    state = go(%{state | looking: nil})
    {:noreply, if(state.waiting == [], do: state, else: look(state))}
  end

  def handle_info(:trim, state) do
    for {_, out} <- state.streams, not out.direct, do: Outgoing.trim(out, state.log, state.retain)
    Process.send_after(self(), :trim, @trim_ms)
    {:noreply, state}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp put(state, out), do: %{state | streams: Map.put(state.streams, out.name, out)}

  defp op(state, name) do
    n = state.writes + 1
    {"#{state.part}.#{name}.#{state.epoch}.f#{n}", %{state | writes: n}}
  end

  @impl true
  def format_status(_reason, [_dictionary, state]),
    do: [data: [{~c"State", %{part: state.part, epoch: state.epoch, mode: state.mode}}]]
end
