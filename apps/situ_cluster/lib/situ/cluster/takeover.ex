defmodule Situ.Cluster.Takeover do
  @moduledoc false
  # Takes over a part in the log, before its publisher publishes anything: fences every stream, so that the previous
  # owner can no longer write, takes over the checkpoints, and starts the log writer. The functions take the arguments
  # of the publisher (`Situ.Cluster.Publisher`).
  alias Situ.Cluster.{Checkpoint, LogWriter, OutgoingStream, StreamEntry}
  alias Situ.Error
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  @type streams :: %{String.t() => OutgoingStream.t()}

  @doc "Fences the streams and takes over the checkpoints. Returns the streams at their positions in the log."
  @spec take_over_part(map(), streams()) ::
          {:ok, streams(), Checkpoint.t()} | {:error, Error.t()}
  def take_over_part(args, streams) do
    with {:ok, streams} <- fence_streams(args, streams, Map.keys(streams), 1),
         marks = Map.new(streams, fn {name, stream} -> {name, stream.stored_mark.last} end),
         key = "ckpt.#{args.deployment}.#{args.part}",
         {:ok, checkpoint} <- Checkpoint.take_over(args.log, key, args.epoch, marks),
         do: {:ok, streams, checkpoint}
  end

  # `n` is the number of this write, so that every operation has a different name.
  defp fence_streams(_args, streams, [], _n), do: {:ok, streams}

  defp fence_streams(args, streams, [name | rest], n) do
    stream = streams[name]

    with {:ok, last} <- Log.fetch_last(args.log, stream.subject) do
      mark = StreamEntry.entry_mark(last)
      seq = if last, do: last.seq, else: 0
      op = "#{args.part}.#{name}.#{args.epoch}.f#{n}"

      case Log.append(
             args.log,
             stream.subject,
             seq,
             StreamEntry.build_fence(mark, args.epoch, op)
           ) do
        {:ok, seq} ->
          stream = OutgoingStream.resume_at(%{stream | seq: seq}, mark)
          fence_streams(args, %{streams | name => stream}, rest, n + 1)

        # The previous owner has written an entry in the meantime. With an older epoch, fencing is simply repeated.
        {:refused, last} ->
          if Entry.head_integer(last, "Epoch", 0) > args.epoch,
            do: {:error, LogWriter.refused_error(stream.subject)},
            else: fence_streams(args, streams, [name | rest], n + 1)

        {:error, error} ->
          {:error, error}
      end
    end
  end

  @doc "Starts the log writer of the calling publisher; it continues after the last entry of each stream."
  @spec start_writer(map(), streams(), Checkpoint.t()) :: {:ok, pid()}
  def start_writer(args, streams, checkpoint) do
    LogWriter.start_link(%{
      log: args.log,
      part: args.part,
      epoch: args.epoch,
      checkpoint: checkpoint,
      streams:
        Map.new(streams, fn {name, stream} ->
          {name, %{subject: stream.subject, seq: stream.seq, mark: stream.stored_mark}}
        end)
    })
  end
end
