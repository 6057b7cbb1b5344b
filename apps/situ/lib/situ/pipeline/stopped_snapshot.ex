defmodule Situ.Pipeline.StoppedSnapshot do
  @moduledoc false
  # The snapshot with which a stage of a stopped part starts again. The stage has reported its final state, after it had
  # handled all messages and the ends of its inputs. A source has also reported its state before it was asked to stop:
  # it starts from there, without the messages that it has posted since. Pure.
  alias Situ.{Error, Stage}
  alias Situ.Graph.Vertex

  @doc "Merges the snapshots of a stage that stopped at `time` and whose first vertex is `head`."
  @spec merge(map(), Situ.Time.t(), Vertex.t()) ::
          {:ok, Stage.Checkpoint.t()} | {:error, Error.t()}
  def merge(%{before: {:ok, before}, after: {:ok, final}}, time, _head) do
    outputs =
      for {from, to} <- Enum.zip(before.outputs, final.outputs), do: skip_posted(from, to, time)

    {:ok, %{before | outputs: outputs}}
  end

  # A source without a snapshot from before the stop has lost its position.
  def merge(%{after: {:ok, final}} = stopped, _time, head) do
    if Vertex.source?(head),
      do: error(stopped[:before], head),
      else: {:ok, %{final | closed: [], ended: [], core: reopen(final.core, head.module)}}
  end

  def merge(stopped, _time, head), do: error(stopped[:after], head)

  # First, an output posts the messages that it holds. It drops messages up to its last time, because the source posts
  # them again.
  defp skip_posted(%{future: {front, rear}, seq: seq} = before, final, time) do
    held = front ++ Enum.reverse(rear)
    posted = final.seq - seq

    if posted <= length(held),
      do: %{before | future: {Enum.drop(held, posted), []}, seq: final.seq},
      else: %{final | future: {[], []}, last_time: min(final.last_time, time)}
  end

  # The inputs are open again.
  defp reopen({:plain, core}, module) do
    if function_exported?(module, :reopen, 1),
      do: {:plain, module.reopen(core)},
      else: {:plain, core}
  end

  defp reopen(core, _module), do: core

  defp error({:error, error}, _head), do: {:error, error}

  defp error(nil, head) do
    {:error,
     Error.new(:no_checkpoint, "#{head.path} has no checkpoint to start from",
       why: "it was stopped without a checkpoint, or ended by itself",
       fix: "stop it with checkpoint: true, or start it with from: :fresh",
       meta: %{component: head.path}
     )}
  end
end
