defmodule Situ.Stage.Checkpoint do
  @moduledoc false
  # A stage's snapshot as plain data: the component's snapshot, the states of its operators, the progress of its
  # outputs, its timers and its closed inputs. It is taken while no messages wait for the stage (see
  # `Situ.Pipeline.PendingCheckpoint`). A stage that starts with a snapshot continues from there.
  # See docs/adr/0111-checkpoints-pause-the-sources.md.
  alias Situ.Error
  alias Situ.Clock.Timers
  alias Situ.Component.{Callback, Snapshot}
  alias Situ.Operator.Chain
  alias Situ.Ports.{Inputs, Output, Outputs}
  alias Situ.Stage.{State, Step}

  @type t :: %{
          core: Snapshot.t() | nil,
          steps: [{non_neg_integer(), term()}],
          outputs: [map()],
          timers: [{Situ.Time.t(), term()}],
          closed: [atom()],
          continue: :none | {:some, term()},
          ended: [Situ.Component.action()]
        }

  @spec take_snapshot(State.t()) :: {:ok, t()} | {:error, Error.t()}
  def take_snapshot(%{steps: steps} = state) when elem(steps, 0).phase == :failed do
    path = State.head_vertex(state).path

    {:error,
     Error.new(:component_failed, "#{path} has failed, so it has no state for a checkpoint")}
  end

  def take_snapshot(%{steps: steps} = state) do
    first = elem(steps, 0)
    path = State.head_vertex(state).path
    marks = Enum.map(list_outputs(state), &output_mark/1)

    with {:ok, core} <- component_snapshot(first.worker, path),
         {:ok, operators} <- Snapshot.to_plain_data(operator_states(state), path),
         {:ok, timers} <- Snapshot.to_plain_data(Timers.to_list(first.timers), path),
         {:ok, outputs} <- Snapshot.to_plain_data(marks, path) do
      {:ok,
       %{
         core: core,
         steps: operators,
         outputs: outputs,
         timers: timers,
         closed: Inputs.closed_names(first.inputs),
         continue: first.work.continue,
         ended: end_actions(first)
       }}
    end
  end

  defp list_outputs(state),
    do: for(step <- State.list_steps(state), output <- Outputs.list_all(step.outputs), do: output)

  # A source announces its end once; a restored one has to announce it again.
  defp end_actions(%{source: %{kind: nil}}), do: []

  defp end_actions(%{source: source, outputs: outputs}) do
    closed =
      for {name, output} <- outputs.own,
          time = Output.closing_time(output),
          do: {:close, name, time}

    last = for %{last_time: time} <- Outputs.list_all(outputs), time != nil, do: time

    if closed == [] and source.completed,
      do: [{:complete, source.completing || Enum.max(last, fn -> 0 end)}],
      else: closed
  end

  defp component_snapshot(%Callback{module: module, core: core}, path),
    do: Snapshot.take_snapshot(module, core, path)

  defp component_snapshot(_chain, _path), do: {:ok, nil}

  defp operator_states(state) do
    for %{worker: %Chain{steps: steps}} <- State.list_steps(state),
        {:step, _fun, index, operator} <- steps,
        do: {index, operator}
  end

  defp output_mark(%Output{} = output),
    do: Map.take(output, [:last_time, :last_creation, :seq, :wanted, :future])

  @doc "Prepares the outputs, before the component starts, to continue after the messages that they have posted."
  @spec prepare_outputs(State.t()) :: State.t()
  def prepare_outputs(%{memory: nil} = state), do: state

  def prepare_outputs(%{memory: memory} = state) do
    ports = for %{port: port} <- list_outputs(state), do: port
    marks = Map.new(Enum.zip(ports, memory.outputs))
    State.map_steps(state, fn step -> Step.map_outputs(step, &resume_output(&1, marks)) end)
  end

  defp resume_output(output, marks) do
    output |> struct!(Map.fetch!(marks, output.port)) |> Output.resume_after_restart()
  end

  @doc "Restores the rest after the component's start; returns the actions that announce its end, if any."
  @spec restore_state(State.t()) ::
          {:ok, State.t(), [Situ.Component.action()]} | {:error, Error.t()}
  def restore_state(%{memory: nil} = state), do: {:ok, state, []}

  def restore_state(%{memory: memory} = state) do
    path = State.head_vertex(state).path

    with {:ok, first} <- restore_component(elem(state.steps, 0), memory, path),
         state = State.put_step(%{state | memory: nil}, 0, first),
         {:ok, operators} <-
           Snapshot.fill_functions(memory.steps, operator_states(state), path) do
      {:ok, State.map_steps(state, &restore_operators(&1, Map.new(operators))), memory.ended}
    end
  end

  defp restore_component(%{worker: %Callback{} = worker} = step, memory, path) do
    with {:ok, core} <- Snapshot.restore_state(worker.module, memory.core, worker.core, path) do
      timers =
        for {time, key} <- memory.timers, reduce: Timers.clear(step.timers) do
          timers -> Timers.add(timers, time, key)
        end

      {:ok,
       %{
         step
         | worker: %{worker | core: core},
           timers: timers,
           work: %{step.work | continue: memory.continue},
           inputs: Inputs.restore_reported(step.inputs, memory.closed)
       }}
    end
  end

  defp restore_component(step, memory, _path),
    do: {:ok, %{step | inputs: Inputs.restore_reported(step.inputs, memory.closed)}}

  defp restore_operators(%{worker: %Chain{} = chain} = step, operators) do
    restore = fn
      {:step, fun, index, state} -> {:step, fun, index, Map.get(operators, index, state)}
      other -> other
    end

    %{step | worker: Chain.update_steps(chain, &Enum.map(&1, restore))}
  end

  defp restore_operators(step, _operators), do: step
end
