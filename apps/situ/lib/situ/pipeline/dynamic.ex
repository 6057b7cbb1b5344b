defmodule Situ.Pipeline.Dynamic do
  @moduledoc false
  # Pending requests that change a running pipeline. Each has a reference, names the stages that owe it a reply, and
  # fails if such a stage ends before it has replied.
  #
  #   taps        by the id of their stage: Dynamic.Tap
  #   inputs      inputs being added or removed: Dynamic.Input
  #   checkpoint  the current checkpoint: PendingCheckpoint
  #   replaces    for each stage, the current replacement and the waiting ones: Dynamic.Replacement
  defstruct taps: %{}, inputs: %{}, replaces: %{}, checkpoint: nil

  @type t :: %__MODULE__{
          taps: %{pos_integer() => map()},
          inputs: %{term() => map()},
          replaces: %{pos_integer() => {map(), :queue.queue(map())}},
          checkpoint: map() | nil
        }

  @doc "Replies to all callers that still wait, because the pipeline has ended."
  @spec cancel_requests(t(), term()) :: :ok
  def cancel_requests(dynamic, answer) do
    waiting =
      for(%{from: from} <- Map.values(dynamic.taps), do: from) ++
        for(%{from: from} <- Map.values(dynamic.inputs), do: from) ++
        for(
          {current, queue} <- Map.values(dynamic.replaces),
          %{from: from} <- [current | :queue.to_list(queue)],
          do: from
        ) ++ waiting_caller(dynamic.checkpoint)

    for from <- waiting, from != nil, do: GenServer.reply(from, answer)
    :ok
  end

  # The caller of a held checkpoint has already received its reply.
  defp waiting_caller(%{step: step, from: from}) when step != :held, do: [from]
  defp waiting_caller(_none), do: []
end
