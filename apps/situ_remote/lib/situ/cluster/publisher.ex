defmodule Situ.Cluster.Publisher do
  @moduledoc false
  # Publishes a part's outputs: into the log, and to the parts that read them. One process for each running part, on
  # its node; towards readers it is a GenStage producer. A reader that is behind gets the missing messages out of the
  # log.
  #
  # It begins by taking over (ADR 0112): fences every stream, takes the checkpoints over, and publishes what the last
  # checkpoint holds that is not in the log yet. A write that is refused ends it: another node has taken over.
  #
  # Two modes. `:outbox`: what the part puts out is seen by nobody before a checkpoint holds it. `:replay`
  # (deterministic parts): it is seen at once and written to the log behind; a part that starts again makes the same.
  use GenServer

  alias Situ.Cluster.{Checkpoint, Chunk, Outgoing, Readers}
  alias Situ.Error
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry

  @flush_ms 5
  # Of one entry of the log, unless it takes less.
  @entry_bytes 4 * 1024 * 1024
  @retry_ms 50
  @trim_ms 1_000

  defstruct [
    :log,
    :part,
    :epoch,
    :mode,
    :checkpoint,
    :runner,
    :retain,
    streams: %{},
    readers: %Readers{},
    cut: nil,
    writes: 0,
    timer: nil,
    waiting: [],
    told_full: false
  ]

  @doc "Takes the part over and publishes it; answers the memories of its last checkpoint, `nil` or `:done`."
  @spec start_link(map()) :: {:ok, pid()} | {:error, term()}
  def start_link(args), do: GenServer.start_link(__MODULE__, args)

  @doc "The memories that the part continues from."
  @spec resume(pid()) :: map() | nil | :done
  def resume(publisher), do: GenServer.call(publisher, :resume, :infinity)

  @doc "Messages of a stream; returns when there is room for more."
  @spec publish(pid(), String.t(), [Situ.Message.t()]) :: :ok
  def publish(publisher, stream, messages),
    do: GenServer.call(publisher, {:publish, stream, messages}, :infinity)

  @doc "A stream has ended."
  @spec close(pid(), String.t(), Situ.Time.t()) :: :ok
  def close(publisher, stream, time),
    do: GenServer.call(publisher, {:close, stream, time}, :infinity)

  @doc "While the part stands still: what it has put out up to now belongs to the checkpoint that follows."
  @spec cut(pid()) :: :ok
  def cut(publisher), do: GenServer.call(publisher, :cut, :infinity)

  @doc "Stores the checkpoint, and what belongs to it."
  @spec commit(pid(), map() | :done) :: :ok
  def commit(publisher, memories), do: GenServer.call(publisher, {:commit, memories}, :infinity)

  @doc "Numbers for people."
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
      streams: Map.new(args.streams, &{&1, Outgoing.new(&1, args.deployment)})
    }

    with {:ok, state} <- fence(state, Map.keys(state.streams)),
         marks = Map.new(state.streams, fn {name, out} -> {name, out.stored.last} end),
         key = "ckpt.#{args.deployment}.#{args.part}",
         {:ok, checkpoint} <- Checkpoint.take(state.log, key, state.epoch, marks) do
      if state.retain != :all, do: Process.send_after(self(), :trim, @trim_ms)
      {:ok, publish_pending(%{state | checkpoint: checkpoint})}
    else
      {:error, error} -> {:stop, {:shutdown, error}}
    end
  catch
    {:situ_refused, subject} -> {:stop, {:shutdown, refused(subject)}}
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
          out = %{out | seq: seq, mark: mark, stored: mark}
          fence(put(state, out), rest)

        # The owner before wrote in between: that counts, if it is one before.
        {:refused, last} ->
          if Entry.integer(last, "Epoch", 0) > state.epoch,
            do: {:error, refused(out.subject)},
            else: fence(state, [name | rest])

        {:error, error} ->
          {:error, error}
      end
    end
  end

  # Publishes the messages that the checkpoint holds and the log lacks.
  defp publish_pending(%{checkpoint: %{current: nil}} = state), do: state

  defp publish_pending(%{checkpoint: %{current: %{pending: pending}}} = state) do
    Enum.reduce(pending, state, fn {name, {messages, mark}}, state ->
      out = Map.fetch!(state.streams, name)

      if out.stored != mark and mark.last >= out.stored.last do
        messages = Enum.drop_while(messages, &(&1.sequence_id <= out.stored.last))
        store(put(state, %{out | mark: mark}), name, {messages, mark})
      else
        state
      end
    end)
  end

  @impl true
  def handle_call(:resume, _from, state) do
    {:reply, Checkpoint.memories(state.checkpoint), state}
  end

  def handle_call({:publish, name, messages}, from, state) do
    {fresh, out} = state.streams |> Map.fetch!(name) |> Outgoing.add(messages)
    state = put(state, out)

    if state.mode == :replay,
      do: state |> show(name, fresh) |> replayed(from),
      else: {:reply, :ok, full(state)}
  end

  def handle_call({:close, name, time}, _from, state) do
    state = put(state, Outgoing.close(Map.fetch!(state.streams, name), time))
    {:reply, :ok, if(state.mode == :replay, do: flush(state), else: state)}
  end

  def handle_call(:cut, _from, state), do: {:reply, :ok, cut_now(state)}

  def handle_call({:commit, memories}, _from, state) do
    state = if state.cut == nil or memories == :done, do: cut_now(state), else: state
    {:reply, :ok, commit_now(state, memories)}
  end

  def handle_call(:info, _from, state) do
    streams =
      Map.new(state.streams, fn {name, out} ->
        {name, %{messages: out.stored.last, time: out.stored.time, closed: out.stored.closing}}
      end)

    {:reply, %{streams: streams, readers: Readers.info(state.readers), mode: state.mode}, state}
  end

  # A deterministic part: everything is written a moment later, and nobody waits unless there is too much of it.
  defp replayed(state, from) do
    if Enum.any?(state.streams, fn {_, out} -> Outgoing.full?(out) end) do
      GenServer.reply(from, :ok)
      {:noreply, flush(state)}
    else
      {:reply, :ok, timed(state)}
    end
  end

  defp timed(%{timer: nil} = state),
    do: %{state | timer: Process.send_after(self(), :flush, @flush_ms)}

  defp timed(state), do: state

  # A checkpoint is due sooner than by the clock.
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
    state.streams
    |> Map.keys()
    |> Enum.reduce(%{state | timer: nil}, fn name, state ->
      out = state.streams[name]

      if Outgoing.pending?(out) do
        {pending, out} = Outgoing.take(out)
        store(put(state, out), name, pending)
      else
        state
      end
    end)
  end

  defp cut_now(%{mode: :replay} = state) do
    %{flush(state) | cut: %{}}
  end

  # Messages left from an earlier cut are older, so they go first.
  defp cut_now(%{mode: :outbox} = state) do
    {cut, streams} =
      Enum.reduce(state.streams, {%{}, state.streams}, fn {name, out}, {cut, streams} ->
        {{messages, mark}, out} = Outgoing.take(out)
        {older, _} = (state.cut || %{}) |> Map.get(name, {[], mark})
        {Map.put(cut, name, {older ++ messages, mark}), Map.put(streams, name, out)}
      end)

    %{state | cut: cut, streams: streams, told_full: false}
  end

  defp commit_now(state, memories) do
    base = Map.new(state.streams, fn {name, out} -> {name, out.stored.last} end)

    pending =
      for {name, {_, mark} = cut} <- state.cut,
          mark != state.streams[name].stored,
          do: {name, cut}

    current = %{memories: memories, base: base, pending: Map.new(pending)}

    checkpoint =
      patiently(fn -> Checkpoint.store(state.checkpoint, state.log, state.epoch, current) end)

    Enum.reduce(pending, %{state | checkpoint: checkpoint, cut: nil}, fn {name, cut}, state ->
      store(state, name, cut)
    end)
  end

  # Into the log, and, unless readers have seen it before, to them.
  defp store(state, name, {messages, mark}) do
    state = append(state, name, messages, mark)
    state = if state.mode == :outbox, do: show(state, name, messages), else: state
    serve(state, name)
  end

  defp append(state, name, messages, mark) do
    out = state.streams[name]
    {op, state} = op(state, name)
    entry = Chunk.data(messages, mark, state.epoch, op)

    size = :erlang.iolist_size(entry.data)
    limit = Log.limit(state.log)
    single? = not match?([_, _ | _], messages)

    cond do
      size <= limit and (single? or size <= @entry_bytes) ->
        seq = patiently(fn -> Log.append(state.log, out.subject, out.seq, entry) end, out.subject)
        put(state, %{out | seq: seq, stored: mark})

      not single? ->
        {first, second} = Enum.split(messages, div(length(messages), 2))
        last = List.last(first)

        half = %{
          mark
          | last: last.sequence_id,
            time: last.originating_time,
            made: last.creation_time,
            closing: nil
        }

        state |> append(name, first, half) |> append(name, second, mark)

      true ->
        exit({:shutdown, too_large(name, size, limit)})
    end
  end

  # The log may be away for a while: the lease says for how long that is borne.
  defp patiently(write, subject \\ nil) do
    case write.() do
      {:ok, result} ->
        result

      {:refused, _last} ->
        exit({:shutdown, refused(subject)})

      {:error, %Error{code: :refused} = error} ->
        exit({:shutdown, error})

      {:error, _error} ->
        receive do
        after
          @retry_ms -> patiently(write, subject)
        end
    end
  end

  defp show(state, name, messages) do
    state |> put(Outgoing.show(state.streams[name], messages)) |> serve(name)
  end

  defp serve(state, name),
    do: %{state | readers: Readers.serve(state.readers, state.streams[name], state.log)}

  # Readers

  @impl true
  def handle_info({:"$gen_producer", {pid, ref}, {:subscribe, _, opts}}, state)
      when is_pid(pid) and is_list(opts) do
    name = opts[:stream]

    if is_map_key(state.streams, name) do
      readers = Readers.join(state.readers, pid, ref, name, opts)
      {:noreply, serve(%{state | readers: readers}, name)}
    else
      error = Error.new(:unknown_stream, "part #{state.part} publishes no #{inspect(name)}")
      send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, error}})
      {:noreply, state}
    end
  end

  def handle_info({:"$gen_producer", {_pid, ref}, {:ask, n}}, state)
      when is_integer(n) and n > 0 do
    case Readers.ask(state.readers, ref, n) do
      {:ok, name, readers} -> {:noreply, serve(%{state | readers: readers}, name)}
      :error -> {:noreply, state}
    end
  end

  def handle_info({:"$gen_producer", {pid, ref}, {:cancel, _reason}}, state) do
    send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, :normal}})
    {:noreply, %{state | readers: Readers.leave(state.readers, ref)}}
  end

  def handle_info({:DOWN, monitor, :process, _, _}, state),
    do: {:noreply, %{state | readers: Readers.gone(state.readers, monitor)}}

  def handle_info(:flush, state), do: {:noreply, flush(state)}

  def handle_info(:trim, state) do
    for {_, out} <- state.streams, do: Outgoing.trim(out, state.log, state.retain)
    Process.send_after(self(), :trim, @trim_ms)
    {:noreply, state}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp put(state, out), do: %{state | streams: Map.put(state.streams, out.name, out)}

  defp op(state, name) do
    n = state.writes + 1
    {"#{state.part}.#{name}.#{state.epoch}.#{n}", %{state | writes: n}}
  end

  defp refused(subject) do
    Error.new(:refused, "the log refuses this node's writes (#{inspect(subject)})",
      why: "another node has taken the part over"
    )
  end

  defp too_large(name, size, limit) do
    Error.new(:too_large, "a message of #{name} is #{size} bytes; the log takes #{limit} at most",
      fix: "raise the server's max_payload, or send smaller messages (encoded pictures)"
    )
  end

  @impl true
  def format_status(_reason, [_dictionary, state]),
    do: [data: [{~c"State", %{part: state.part, epoch: state.epoch, mode: state.mode}}]]
end
