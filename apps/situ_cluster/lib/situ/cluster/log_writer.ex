defmodule Situ.Cluster.LogWriter do
  @moduledoc false
  # Writes the messages that a part publishes into the log, so that its publisher can keep serving readers, who see
  # the outputs of a deterministic part before the log contains them. The two processes are linked. Entries are
  # written in the order of the casts, and each stream has only one write in progress. Sends its publisher
  # `{:situ_stored, name, mark, seq}` after each write. A refused write ends both processes, because another node
  # has taken over the part.
  # See docs/adr/0117-readers-do-not-wait-for-the-log.md.
  use GenServer

  alias Situ.Cluster.{MessageBatch, Checkpoint, StreamEntry, SignedEntry}
  alias Situ.Error
  alias Situ.Cluster.Log

  # The largest size of one entry of the log, unless the log's own limit is smaller.
  @entry_bytes 4 * 1024 * 1024
  @retry_ms 50

  @enforce_keys [:log, :part, :epoch, :publisher, :checkpoint, :streams]
  defstruct [:log, :part, :epoch, :publisher, :checkpoint, :streams, writes: 0]

  @typedoc "The subject of each stream, the number of its last entry, and its position in the log."
  @type streams :: %{
          String.t() => %{
            subject: Log.subject(),
            seq: non_neg_integer(),
            mark: StreamEntry.mark()
          }
        }

  @doc "Starts the process. `args`: log, part, epoch, checkpoint (as taken over) and streams."
  @spec start_link(map()) :: {:ok, pid()}
  def start_link(args),
    do: GenServer.start_link(__MODULE__, struct!(__MODULE__, Map.put(args, :publisher, self())))

  @doc "Appends batches; `mark` is the position of the stream after them."
  @spec append_batches(pid(), String.t(), [MessageBatch.t()], StreamEntry.mark()) :: :ok
  def append_batches(writer, name, batches, mark),
    do: GenServer.cast(writer, {:append, name, batches, mark})

  @doc """
  Stores a checkpoint with `outputs`, which precede the checkpoint and are not in the log yet. Then appends these
  outputs and replies to `from`.
  """
  @spec commit_checkpoint(
          pid(),
          map() | :done,
          %{String.t() => {[MessageBatch.t()], StreamEntry.mark()}},
          GenServer.from()
        ) ::
          :ok
  def commit_checkpoint(writer, memories, outputs, from),
    do: GenServer.cast(writer, {:commit, memories, outputs, from})

  @impl true
  def init(state), do: {:ok, state}

  @impl true
  def handle_cast({:append, name, batches, mark}, state),
    do: {:noreply, write_and_report(state, name, {batches, mark})}

  def handle_cast({:commit, memories, outputs, from}, state) do
    base = Map.new(state.streams, fn {name, stream} -> {name, stream.mark.last} end)
    pending = Map.filter(outputs, fn {name, {_, mark}} -> mark != state.streams[name].mark end)
    current = %{memories: memories, base: base, pending: pending}

    checkpoint =
      retry_write(fn ->
        Checkpoint.write_next(state.checkpoint, state.log, state.epoch, current)
      end)

    state =
      Enum.reduce(pending, %{state | checkpoint: checkpoint}, fn {name, outputs}, state ->
        write_and_report(state, name, outputs)
      end)

    GenServer.reply(from, :ok)
    {:noreply, state}
  end

  defp write_and_report(state, name, {batches, mark}) do
    state = write_entry(state, name, batches, mark)
    send(state.publisher, {:situ_stored, name, mark, state.streams[name].seq})
    state
  end

  defp write_entry(state, name, batches, mark) do
    stream = state.streams[name]
    writes = state.writes + 1

    entry =
      StreamEntry.build_data(
        batches,
        mark,
        state.epoch,
        "#{state.part}.#{name}.#{state.epoch}.w#{writes}"
      )

    state = %{state | writes: writes}

    size = :erlang.iolist_size(entry.data)
    limit = Log.max_data_size(state.log)

    cond do
      size <= limit and (size <= @entry_bytes or single_message?(batches)) ->
        write = fn -> Log.append(state.log, stream.subject, stream.seq, entry) end
        stream = %{stream | seq: retry_write(write, stream.subject), mark: mark}
        %{state | streams: Map.put(state.streams, name, stream)}

      single_message?(batches) ->
        exit({:shutdown, too_large_error(name, size, limit)})

      true ->
        {first, second} = split_in_half(batches)

        state
        |> write_entry(name, first, mark_after(mark, List.last(first)))
        |> write_entry(name, second, mark)
    end
  end

  defp single_message?([]), do: true
  defp single_message?([%{first: id, last: id}]), do: true
  defp single_message?(_batches), do: false

  defp split_in_half([batch]) do
    {first, second} = MessageBatch.split_in_half(batch)
    {[first], [second]}
  end

  defp split_in_half(batches), do: Enum.split(batches, div(length(batches), 2))

  defp mark_after(mark, batch),
    do: %{mark | last: batch.last, time: batch.time, made: batch.made, closing: nil}

  # The log may be unreachable for a while. The lease limits how long this is tolerated.
  defp retry_write(write, subject \\ nil) do
    case write.() do
      {:ok, result} ->
        result

      {:refused, _last} ->
        exit({:shutdown, refused_error(subject)})

      {:error, %Error{} = error} ->
        if error.code == :refused or SignedEntry.refusal?(error), do: exit({:shutdown, error})

        receive do
        after
          @retry_ms -> retry_write(write, subject)
        end
    end
  end

  @doc "Returns the error for a writer whose part another node has taken over."
  @spec refused_error(Log.subject() | nil) :: Error.t()
  def refused_error(subject) do
    Error.new(:refused, "the log refuses this node's writes (#{inspect(subject)})",
      why: "another node has taken the part over"
    )
  end

  defp too_large_error(name, size, limit) do
    Error.new(
      :too_large,
      "a message of #{name} has #{size} bytes; the log accepts at most #{limit}",
      fix:
        "raise the server's max_payload, send smaller messages (encoded images), or let the stream bypass the" <>
          " log (direct:)"
    )
  end

  @impl true
  def format_status(_reason, [_dictionary, state]),
    do: [data: [{~c"State", %{part: state.part, epoch: state.epoch}}]]
end
