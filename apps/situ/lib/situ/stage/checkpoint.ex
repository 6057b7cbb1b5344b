defmodule Situ.Stage.Checkpoint do
  @moduledoc false
  # A stage's snapshot as plain data: the component's snapshot, the states of its operators, the progress of its
  # outputs, its timers and its closed inputs. It is taken while no messages wait for the stage (see
  # `Situ.Pipeline.PendingCheckpoint`). A stage that starts with a snapshot continues from there.
  # See docs/adr/0111-checkpoints-pause-the-sources.md.
  alias Situ.Error
  alias Situ.Clock.Timers
  alias Situ.Component.Snapshot
  alias Situ.Ports.{Inputs, Output, Outputs}
  alias Situ.Stage.State

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
  def take_snapshot(%{phase: :failed} = state) do
    path = State.head_vertex(state).path

    {:error,
     Error.new(:component_failed, "#{path} has failed, so it has no state for a checkpoint")}
  end

  def take_snapshot(state) do
    path = State.head_vertex(state).path

    with {:ok, core} <- core(state.callback, path),
         {:ok, steps} <- Snapshot.to_plain_data(steps(state.chain), path),
         {:ok, timers} <- Snapshot.to_plain_data(Timers.to_list(state.timers), path),
         {:ok, outputs} <-
           Snapshot.to_plain_data(Enum.map(Outputs.list_all(state.outputs), &mark/1), path) do
      {:ok,
       %{
         core: core,
         steps: steps,
         outputs: outputs,
         timers: timers,
         closed: Inputs.closed_names(state.inputs),
         continue: state.pace.continue,
         ended: ended(state)
       }}
    end
  end

  # A source announces its end once; a restored one has to announce it again.
  defp ended(%{source: %{kind: nil}}), do: []

  defp ended(%{source: source, outputs: outputs}) do
    closed = for {name, %{closing: time}} <- outputs.own, time != nil, do: {:close, name, time}
    last = for %{last_time: time} <- Outputs.list_all(outputs), time != nil, do: time

    if closed == [] and source.completed,
      do: [{:complete, source.completing || Enum.max(last, fn -> 0 end)}],
      else: closed
  end

  defp core(nil, _path), do: {:ok, nil}
  defp core(callback, path), do: Snapshot.take_snapshot(callback.module, callback.core, path)

  defp steps(nil), do: []
  defp steps(chain), do: for({:step, _fun, index, state} <- chain.steps, do: {index, state})

  defp mark(%Output{} = output),
    do: Map.take(output, [:last_time, :last_creation, :seq, :wanted, :future])

  @doc "Prepares the outputs, before the component starts, to continue after the messages that they have posted."
  @spec prepare_outputs(State.t()) :: State.t()
  def prepare_outputs(%{memory: nil} = state), do: state

  def prepare_outputs(%{memory: memory, outputs: outputs} = state) do
    marks = Enum.zip(Outputs.list_all(outputs), memory.outputs)

    outputs =
      Enum.reduce(marks, outputs, fn {%{port: port}, mark}, outputs ->
        Outputs.map_outputs(outputs, &if(&1.port == port, do: resume_output(&1, mark), else: &1))
      end)

    %{state | outputs: outputs}
  end

  defp resume_output(output, mark), do: output |> struct!(mark) |> Output.resume_after_restart()

  @doc "Restores the rest after the component's start; returns the actions that announce its end, if any."
  @spec restore_state(State.t()) ::
          {:ok, State.t(), [Situ.Component.action()]} | {:error, Error.t()}
  def restore_state(%{memory: nil} = state), do: {:ok, state, []}

  def restore_state(%{memory: memory} = state) do
    path = State.head_vertex(state).path

    with {:ok, callback} <- callback(state.callback, memory.core, path),
         {:ok, chain} <- chain(state.chain, memory.steps, path) do
      timers =
        Enum.reduce(memory.timers, Timers.clear(state.timers), fn {time, key}, timers ->
          Timers.add(timers, time, key)
        end)

      pace = %{state.pace | continue: memory.continue}
      state = %{state | callback: callback, chain: chain, timers: timers, pace: pace}
      inputs = Inputs.restore_reported(state.inputs, memory.closed)
      {:ok, %{state | memory: nil, inputs: inputs}, memory.ended}
    end
  end

  defp callback(nil, nil, _path), do: {:ok, nil}

  defp callback(callback, snapshot, path) do
    with {:ok, core} <- Snapshot.restore_state(callback.module, snapshot, callback.core, path),
         do: {:ok, %{callback | core: core}}
  end

  defp chain(nil, _steps, _path), do: {:ok, nil}

  defp chain(chain, steps, path) do
    fresh = for {:step, _fun, index, state} <- chain.steps, do: {index, state}

    with {:ok, steps} <- Snapshot.fill_functions(steps, fresh, path) do
      states = Map.new(steps)

      steps =
        Enum.map(chain.steps, fn
          {:step, fun, index, state} -> {:step, fun, index, Map.get(states, index, state)}
          step -> step
        end)

      {:ok, %{chain | steps: steps}}
    end
  end
end
