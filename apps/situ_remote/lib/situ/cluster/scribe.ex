defmodule Situ.Cluster.Scribe do
  @moduledoc false
  # Writes the messages that a part publishes into the log. It is a separate process, so its publisher can keep serving
  # readers, who see the outputs of a deterministic part before the log contains them. Each publisher has one such
  # process and is linked to it, so that both end together. Entries are written in the order of the casts, and each
  # stream has only one write in progress.
  #
  # Sends its publisher `{:situ_stored, name, mark, seq}` after each write. A refused write ends both processes,
  # because another node has taken over the part.
  use GenServer

  alias Situ.Cluster.{Batch, Checkpoint, Chunk, Seal}
  alias Situ.Error
  alias Situ.Remote.Log

  # The largest size of one entry of the log, unless the log's own limit is smaller.
  @entry_bytes 4 * 1024 * 1024
  @retry_ms 50

  @enforce_keys [:log, :part, :epoch, :publisher, :checkpoint, :streams]
  defstruct [:log, :part, :epoch, :publisher, :checkpoint, :streams, writes: 0]

  @typedoc "The subject of each stream, the number of its last entry, and its position in the log."
  @type streams :: %{
          String.t() => %{subject: Log.subject(), seq: non_neg_integer(), mark: Chunk.mark()}
        }

  @doc "Starts the process. `args`: log, part, epoch, checkpoint (as taken over) and streams."
  @spec start_link(map()) :: {:ok, pid()}
  def start_link(args),
    do: GenServer.start_link(__MODULE__, struct!(__MODULE__, Map.put(args, :publisher, self())))

  @doc "Appends batches; `mark` is the position of the stream after them."
  @spec append(pid(), String.t(), [Batch.t()], Chunk.mark()) :: :ok
  def append(scribe, name, batches, mark),
    do: GenServer.cast(scribe, {:append, name, batches, mark})

  @doc """
  Stores a checkpoint with `cut`, the outputs that precede the checkpoint and are not in the log yet. Then appends
  these outputs and replies to `from`.
  """
  @spec commit(
          pid(),
          map() | :done,
          %{String.t() => {[Batch.t()], Chunk.mark()}},
          GenServer.from()
        ) ::
          :ok
  def commit(scribe, memories, cut, from),
    do: GenServer.cast(scribe, {:commit, memories, cut, from})

  @impl true
  def init(state), do: {:ok, state}

  @impl true
  def handle_cast({:append, name, batches, mark}, state),
    do: {:noreply, append(state, name, {batches, mark})}

  def handle_cast({:commit, memories, cut, from}, state) do
    base = Map.new(state.streams, fn {name, stream} -> {name, stream.mark.last} end)
    pending = Map.filter(cut, fn {name, {_, mark}} -> mark != state.streams[name].mark end)
    current = %{memories: memories, base: base, pending: pending}

    checkpoint =
      patiently(fn -> Checkpoint.store(state.checkpoint, state.log, state.epoch, current) end)

    state =
      Enum.reduce(pending, %{state | checkpoint: checkpoint}, fn {name, cut}, state ->
        append(state, name, cut)
      end)

    GenServer.reply(from, :ok)
    {:noreply, state}
  end

  defp append(state, name, {batches, mark}) do
    state = write(state, name, batches, mark)
    send(state.publisher, {:situ_stored, name, mark, state.streams[name].seq})
    state
  end

  defp write(state, name, batches, mark) do
    stream = state.streams[name]
    writes = state.writes + 1

    entry =
      Chunk.data(batches, mark, state.epoch, "#{state.part}.#{name}.#{state.epoch}.w#{writes}")

    state = %{state | writes: writes}

    size = :erlang.iolist_size(entry.data)
    limit = Log.limit(state.log)

    cond do
      size <= limit and (size <= @entry_bytes or one?(batches)) ->
        write = fn -> Log.append(state.log, stream.subject, stream.seq, entry) end
        stream = %{stream | seq: patiently(write, stream.subject), mark: mark}
        %{state | streams: Map.put(state.streams, name, stream)}

      one?(batches) ->
        exit({:shutdown, too_large(name, size, limit)})

      true ->
        {first, second} = halves(batches)
        state |> write(name, first, half(mark, List.last(first))) |> write(name, second, mark)
    end
  end

  defp one?([]), do: true
  defp one?([%{first: id, last: id}]), do: true
  defp one?(_batches), do: false

  defp halves([batch]) do
    {first, second} = Batch.halves(batch)
    {[first], [second]}
  end

  defp halves(batches), do: Enum.split(batches, div(length(batches), 2))

  defp half(mark, batch),
    do: %{mark | last: batch.last, time: batch.time, made: batch.made, closing: nil}

  # The log may be unreachable for a while. The lease limits how long this is tolerated.
  defp patiently(write, subject \\ nil) do
    case write.() do
      {:ok, result} ->
        result

      {:refused, _last} ->
        exit({:shutdown, refused(subject)})

      {:error, %Error{} = error} ->
        if error.code == :refused or Seal.refusal?(error), do: exit({:shutdown, error})

        receive do
        after
          @retry_ms -> patiently(write, subject)
        end
    end
  end

  @doc "Returns the error for a writer whose part another node has taken over."
  @spec refused(Log.subject() | nil) :: Error.t()
  def refused(subject) do
    Error.new(:refused, "the log refuses this node's writes (#{inspect(subject)})",
      why: "another node has taken the part over"
    )
  end

  defp too_large(name, size, limit) do
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
