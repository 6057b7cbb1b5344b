defmodule Situ.Pipeline.Dynamic do
  @moduledoc false
  # The requests under way that change a running pipeline. Every one has a reference, names the stages that owe it an
  # answer, and is answered when one of these ends before it has given it.
  #
  #   taps      by the id of their stage: Dynamic.Tap
  #   inputs    inputs being added or taken away: Dynamic.Input
  #   checkpoint  the one under way: Checkpointing
  #   replaces  per stage, the replacement under way and those that wait for it: Dynamic.Replacement
  defstruct taps: %{}, inputs: %{}, replaces: %{}, checkpoint: nil

  @type t :: %__MODULE__{
          taps: %{pos_integer() => map()},
          inputs: %{term() => map()},
          replaces: %{pos_integer() => {map(), :queue.queue(map())}},
          checkpoint: map() | nil
        }

  @doc "The pipeline has ended: answers all callers that still wait."
  @spec cancel(t(), term()) :: :ok
  def cancel(dynamic, answer) do
    waiting =
      for(%{from: from} <- Map.values(dynamic.taps), do: from) ++
        for(%{from: from} <- Map.values(dynamic.inputs), do: from) ++
        for(
          {current, queue} <- Map.values(dynamic.replaces),
          %{from: from} <- [current | :queue.to_list(queue)],
          do: from
        ) ++ checkpoint(dynamic.checkpoint)

    for from <- waiting, from != nil, do: GenServer.reply(from, answer)
    :ok
  end

  # Who holds it has its answer.
  defp checkpoint(%{step: step, from: from}) when step != :held, do: [from]
  defp checkpoint(_none), do: []
end
