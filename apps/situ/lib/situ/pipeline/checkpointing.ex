defmodule Situ.Pipeline.Checkpointing do
  @moduledoc false
  # Takes a checkpoint of a running pipeline: the snapshots of its stages (see `Situ.Stage.Memory`) at one moment at
  # which no messages are in flight.
  #   freezing  the sources pause and report their snapshots
  #   settling  the other stages handle all posted messages; checked every millisecond
  #   asking    every other stage reports its snapshot; if any message has moved since, the checkpoint settles again
  #   held      the caller has all snapshots; the sources continue when it says so, or when it has died
  alias Situ.Error
  alias Situ.Pipeline.{Stages, State}

  @enforce_keys [:ref, :from, :monitor, :deadline, :sources]
  defstruct [
    :ref,
    :from,
    :monitor,
    :deadline,
    :sources,
    :mark,
    step: :freezing,
    pending: MapSet.new(),
    memories: %{}
  ]

  @type t :: %__MODULE__{}

  @doc "Begins a checkpoint; the caller receives `{:ok, ref, memories}` or `{:error, error}`."
  @spec ask(State.t(), pos_integer(), GenServer.from()) :: State.t()
  def ask(%{dynamic: %{checkpoint: %__MODULE__{}}} = state, _timeout, from) do
    GenServer.reply(
      from,
      {:error, Error.new(:busy, "a checkpoint of the pipeline is already running")}
    )

    state
  end

  def ask(state, timeout, {pid, _} = from) do
    ids = stages(state)

    case Enum.find(ids, &(not state.life.stages[&1].alive?)) do
      nil ->
        sources = Enum.filter(ids, &source?(state, &1))

        checkpoint = %__MODULE__{
          ref: make_ref(),
          from: from,
          monitor: Process.monitor(pid),
          deadline: System.monotonic_time(:millisecond) + timeout,
          sources: sources
        }

        # A stage that does not reply must not block the checkpoint forever.
        Process.send_after(self(), {:situ_checkpoint, checkpoint.ref}, timeout)
        gather(put(state, checkpoint), :freezing, :freeze, sources)

      id ->
        path = hd(state.stages[id].vertices).path
        error = Error.new(:not_running, "#{path} has ended, so no checkpoint can be taken")
        GenServer.reply(from, {:error, error})
        state
    end
  end

  defp stages(state), do: Map.keys(state.stages) -- Map.keys(state.dynamic.taps)
  defp source?(state, id), do: hd(state.stages[id].vertices).inputs == []

  defp gather(state, step, request, ids) do
    checkpoint = %{state.dynamic.checkpoint | step: step, pending: MapSet.new(ids)}
    state = Enum.reduce(ids, state, &Stages.tell(&2, &1, {request, checkpoint.ref}))
    state |> put(checkpoint) |> next()
  end

  @doc "Handles a stage's snapshot, or the error that prevented it."
  @spec remembered(State.t(), pos_integer(), reference(), {:ok, map()} | {:error, Error.t()}) ::
          State.t()
  def remembered(%{dynamic: %{checkpoint: %{ref: ref} = checkpoint}} = state, id, ref, answer) do
    case answer do
      {:ok, memory} ->
        path = hd(state.stages[id].vertices).path
        memories = Map.put(checkpoint.memories, path, memory)
        pending = MapSet.delete(checkpoint.pending, id)
        state |> put(%{checkpoint | memories: memories, pending: pending}) |> next()

      {:error, error} ->
        fail(state, error)
    end
  end

  # The checkpoint was given up, but the source may still be paused.
  def remembered(state, id, ref, _answer), do: Stages.tell(state, id, {:thaw, ref})

  @doc "Checks again whether the pipeline has settled, or gives up after the deadline."
  @spec look(State.t(), reference()) :: State.t()
  def look(%{dynamic: %{checkpoint: %{ref: ref, step: step}}} = state, ref) when step != :held,
    do: if(late?(state), do: fail(state, restless(state)), else: next(state))

  def look(state, _ref), do: state

  @doc "Ends the checkpoint when the caller has finished or died."
  @spec thaw(State.t(), reference()) :: State.t()
  def thaw(%{dynamic: %{checkpoint: %{ref: ref}}} = state, ref), do: over(state)
  def thaw(%{dynamic: %{checkpoint: %{monitor: ref}}} = state, ref), do: over(state)
  def thaw(state, _ref), do: state

  defp next(%{dynamic: %{checkpoint: %{pending: pending} = checkpoint}} = state) do
    if MapSet.size(pending) > 0, do: state, else: go_on(checkpoint.step, state)
  end

  defp go_on(:freezing, state), do: go_on(:settling, step(state, :settling))

  defp go_on(:settling, state) do
    if Stages.quiet?(state) do
      checkpoint = %{state.dynamic.checkpoint | mark: Stages.fingerprint(state, :all)}
      state |> put(checkpoint) |> gather(:asking, :remember, stages(state) -- checkpoint.sources)
    else
      Process.send_after(self(), {:situ_checkpoint, state.dynamic.checkpoint.ref}, 1)
      state
    end
  end

  defp go_on(:asking, state) do
    checkpoint = state.dynamic.checkpoint

    if Stages.quiet?(state) and Stages.fingerprint(state, :all) == checkpoint.mark do
      GenServer.reply(checkpoint.from, {:ok, checkpoint.ref, checkpoint.memories})
      step(state, :held)
    else
      go_on(:settling, step(state, :settling))
    end
  end

  defp step(state, step), do: put(state, %{state.dynamic.checkpoint | step: step})
  defp put(state, checkpoint), do: %{state | dynamic: %{state.dynamic | checkpoint: checkpoint}}

  defp fail(state, error) do
    GenServer.reply(state.dynamic.checkpoint.from, {:error, error})
    over(state)
  end

  defp over(%{dynamic: %{checkpoint: checkpoint}} = state) do
    Process.demonitor(checkpoint.monitor, [:flush])
    alive = Enum.filter(checkpoint.sources, &is_map_key(state.stages, &1))
    state = Enum.reduce(alive, state, &Stages.tell(&2, &1, {:thaw, checkpoint.ref}))
    put(state, nil)
  end

  defp late?(state),
    do: System.monotonic_time(:millisecond) >= state.dynamic.checkpoint.deadline

  defp restless(_state) do
    Error.new(:not_settled, "no checkpoint was taken: messages were in flight all the time",
      why: "a checkpoint waits until all messages that the sources have posted are handled",
      fix: "allow more time (timeout:), or reduce the pipeline's load"
    )
  end
end
