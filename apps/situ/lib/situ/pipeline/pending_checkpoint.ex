defmodule Situ.Pipeline.PendingCheckpoint do
  @moduledoc false
  # Takes a checkpoint of a running pipeline: the snapshots of its stages (see `Situ.Stage.Checkpoint`) at one moment at
  # which no messages are in flight.
  #   freezing  the sources pause and report their snapshots
  #   settling  the other stages handle all posted messages; checked every millisecond
  #   asking    every other stage reports its snapshot; if any message has moved since, the checkpoint settles again
  #   held      the caller has all snapshots; the sources continue when it says so, or when it has died
  # See docs/adr/0111-checkpoints-pause-the-sources.md.
  alias Situ.{Error, Runtime}
  alias Situ.Lifecycle.Operations
  alias Situ.Pipeline.{Stages, State}

  @enforce_keys [:ref, :monitor, :deadline, :sources]
  defstruct [
    :ref,
    :monitor,
    :deadline,
    :sources,
    :mark,
    step: :freezing,
    pending: MapSet.new(),
    memories: %{}
  ]

  @type t :: %__MODULE__{}
  @typep result :: {State.t(), [Situ.Lifecycle.event()]}

  @doc "Begins the checkpoint `op`; `caller` receives `{:ok, op, memories}`, or the operation ends with an error."
  @spec begin(State.t(), Operations.id(), pos_integer(), pid()) :: result()
  def begin(state, op, timeout, caller) do
    ids = stage_ids(state)

    case Enum.find(ids, &(not state.life.stages[&1].alive?)) do
      nil ->
        sources = Enum.filter(ids, &source_stage?(state, &1))

        checkpoint = %__MODULE__{
          ref: op,
          monitor: Process.monitor(caller),
          deadline: Runtime.monotonic_time() + timeout * 1_000_000,
          sources: sources
        }

        # A stage that does not reply must not block the checkpoint forever.
        Runtime.send_after({:situ_checkpoint, op}, timeout)
        request_snapshots(put_checkpoint(state, checkpoint), :freezing, :freeze, sources)

      id ->
        {state, [{:finished, op, {:error, ended_error(state, id)}}]}
    end
  end

  @doc "Ends the checkpoint with an error when the process of a stage has ended before its state is known."
  @spec fail_pending(State.t(), pos_integer()) :: result()
  def fail_pending(%{dynamic: %{checkpoint: %{step: step}, taps: taps}} = state, id)
      when step != :held and not is_map_key(taps, id),
      do: fail_checkpoint(state, ended_error(state, id))

  def fail_pending(state, _id), do: {state, []}

  defp ended_error(state, id) do
    path = hd(state.stages[id].vertices).path
    Error.new(:not_running, "#{path} has ended, so no checkpoint can be taken")
  end

  defp stage_ids(state), do: Map.keys(state.stages) -- Map.keys(state.dynamic.taps)
  defp source_stage?(state, id), do: hd(state.stages[id].vertices).inputs == []

  defp request_snapshots(state, step, request, ids) do
    checkpoint = %{state.dynamic.checkpoint | step: step, pending: MapSet.new(ids)}
    state = Enum.reduce(ids, state, &Stages.send_request(&2, &1, {request, checkpoint.ref}))
    state |> put_checkpoint(checkpoint) |> advance_if_ready()
  end

  @doc "Handles a stage's snapshot, or the error that prevented it."
  @spec handle_snapshot(
          State.t(),
          pos_integer(),
          Operations.id(),
          {:ok, map()} | {:error, Error.t()}
        ) :: result()
  def handle_snapshot(
        %{dynamic: %{checkpoint: %{ref: ref} = checkpoint}} = state,
        id,
        ref,
        answer
      ) do
    case answer do
      {:ok, memory} ->
        path = hd(state.stages[id].vertices).path
        memories = Map.put(checkpoint.memories, path, memory)
        pending = MapSet.delete(checkpoint.pending, id)

        state
        |> put_checkpoint(%{checkpoint | memories: memories, pending: pending})
        |> advance_if_ready()

      # The stage has received results that it has not emitted yet. Without a mark, the checkpoint settles again.
      {:error, %Error{code: :not_settled}} when checkpoint.step == :asking ->
        pending = MapSet.delete(checkpoint.pending, id)
        state |> put_checkpoint(%{checkpoint | pending: pending, mark: nil}) |> advance_if_ready()

      {:error, error} ->
        fail_checkpoint(state, error)
    end
  end

  # The checkpoint was given up, but the source may still be paused.
  def handle_snapshot(state, id, ref, _answer),
    do: {Stages.send_request(state, id, {:thaw, ref}), []}

  @doc "Checks again whether the pipeline has settled, or gives up after the deadline."
  @spec poll_progress(State.t(), Operations.id()) :: result()
  def poll_progress(%{dynamic: %{checkpoint: %{ref: ref, step: step}}} = state, ref)
      when step != :held,
      do:
        if(past_deadline?(state),
          do: fail_checkpoint(state, not_settled_error(state)),
          else: advance_if_ready(state)
        )

  def poll_progress(state, _ref), do: {state, []}

  @doc "Ends the checkpoint when the caller has finished or died."
  @spec thaw_sources(State.t(), Operations.id() | reference()) :: result()
  def thaw_sources(%{dynamic: %{checkpoint: %{ref: op, monitor: monitor}}} = state, ref)
      when ref in [op, monitor],
      do: end_checkpoint(state, :ok)

  def thaw_sources(state, _ref), do: {state, []}

  defp advance_if_ready(%{dynamic: %{checkpoint: %{pending: pending} = checkpoint}} = state) do
    if MapSet.size(pending) > 0, do: {state, []}, else: advance_step(checkpoint.step, state)
  end

  defp advance_step(:freezing, state), do: advance_step(:settling, put_step(state, :settling))

  defp advance_step(:settling, state) do
    if Stages.no_messages_in_flight?(state) do
      checkpoint = %{state.dynamic.checkpoint | mark: Stages.fingerprint(state, :all)}

      state
      |> put_checkpoint(checkpoint)
      |> request_snapshots(:asking, :remember, stage_ids(state) -- checkpoint.sources)
    else
      Runtime.send_after({:situ_checkpoint, state.dynamic.checkpoint.ref}, 1)
      {state, []}
    end
  end

  defp advance_step(:asking, state) do
    checkpoint = state.dynamic.checkpoint

    if Stages.no_messages_in_flight?(state) and Stages.fingerprint(state, :all) == checkpoint.mark do
      # Other operations continue while the caller uses the checkpoint; another checkpoint waits.
      answer = {:ok, checkpoint.ref, checkpoint.memories}
      {put_step(state, :held), [{:answered, checkpoint.ref, answer, [:checkpoint]}]}
    else
      advance_step(:settling, put_step(state, :settling))
    end
  end

  defp put_step(state, step), do: put_checkpoint(state, %{state.dynamic.checkpoint | step: step})

  defp put_checkpoint(state, checkpoint),
    do: %{state | dynamic: %{state.dynamic | checkpoint: checkpoint}}

  defp fail_checkpoint(state, error), do: end_checkpoint(state, {:error, error})

  defp end_checkpoint(%{dynamic: %{checkpoint: checkpoint}} = state, answer) do
    Process.demonitor(checkpoint.monitor, [:flush])
    alive = Enum.filter(checkpoint.sources, &is_map_key(state.stages, &1))
    state = Enum.reduce(alive, state, &Stages.send_request(&2, &1, {:thaw, checkpoint.ref}))
    {put_checkpoint(state, nil), [{:finished, checkpoint.ref, answer}]}
  end

  defp past_deadline?(state),
    do: Runtime.monotonic_time() >= state.dynamic.checkpoint.deadline

  defp not_settled_error(_state) do
    Error.new(:not_settled, "no checkpoint was taken: messages were in flight all the time",
      why: "a checkpoint waits until all messages that the sources have posted are handled",
      fix: "allow more time (timeout:), or reduce the pipeline's load"
    )
  end
end
