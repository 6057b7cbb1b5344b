defmodule Situ.Stage.Memory do
  @moduledoc false
  # A stage's snapshot as plain data: the component's snapshot, the states of its operators, the progress of its
  # outputs, its timers and its closed inputs. It is taken while no messages wait for the stage (see
  # `Situ.Pipeline.Checkpointing`). A stage that starts with a snapshot continues from there.
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

  @spec take(State.t()) :: {:ok, t()} | {:error, Error.t()}
  def take(%{phase: :failed} = state) do
    path = State.head(state).path

    {:error,
     Error.new(:component_failed, "#{path} has failed, so it has no state for a checkpoint")}
  end

  def take(state) do
    path = State.head(state).path

    with {:ok, core} <- core(state.callback, path),
         {:ok, steps} <- Snapshot.plain(steps(state.chain), path),
         {:ok, timers} <- Snapshot.plain(Timers.to_list(state.timers), path),
         {:ok, outputs} <- Snapshot.plain(Enum.map(Outputs.all(state.outputs), &mark/1), path) do
      {:ok,
       %{
         core: core,
         steps: steps,
         outputs: outputs,
         timers: timers,
         closed: Inputs.closed(state.inputs),
         continue: state.pace.continue,
         ended: ended(state)
       }}
    end
  end

  # A source announces its end once; a restored one has to announce it again.
  defp ended(%{source: %{kind: nil}}), do: []

  defp ended(%{source: source, outputs: outputs}) do
    closed = for {name, %{closing: time}} <- outputs.own, time != nil, do: {:close, name, time}
    last = for %{last_time: time} <- Outputs.all(outputs), time != nil, do: time

    if closed == [] and source.completed,
      do: [{:complete, source.completing || Enum.max(last, fn -> 0 end)}],
      else: closed
  end

  defp core(nil, _path), do: {:ok, nil}
  defp core(callback, path), do: Snapshot.take(callback.module, callback.core, path)

  defp steps(nil), do: []
  defp steps(chain), do: for({:step, _fun, index, state} <- chain.steps, do: {index, state})

  defp mark(%Output{} = output),
    do: Map.take(output, [:last_time, :last_creation, :seq, :wanted, :future])

  @doc "Prepares the outputs, before the component starts, to continue after the messages that they have posted."
  @spec prepare(State.t()) :: State.t()
  def prepare(%{memory: nil} = state), do: state

  def prepare(%{memory: memory, outputs: outputs} = state) do
    marks = Enum.zip(Outputs.all(outputs), memory.outputs)

    outputs =
      Enum.reduce(marks, outputs, fn {%{port: port}, mark}, outputs ->
        Outputs.each(outputs, &if(&1.port == port, do: again(&1, mark), else: &1))
      end)

    %{state | outputs: outputs}
  end

  defp again(output, mark), do: output |> struct!(mark) |> Output.resume()

  @doc "Restores the rest after the component's start; returns the actions that announce its end, if any."
  @spec put(State.t()) :: {:ok, State.t(), [Situ.Component.action()]} | {:error, Error.t()}
  def put(%{memory: nil} = state), do: {:ok, state, []}

  def put(%{memory: memory} = state) do
    path = State.head(state).path

    with {:ok, callback} <- callback(state.callback, memory.core, path),
         {:ok, chain} <- chain(state.chain, memory.steps, path) do
      timers =
        Enum.reduce(memory.timers, Timers.clear(state.timers), fn {time, key}, timers ->
          Timers.add(timers, time, key)
        end)

      pace = %{state.pace | continue: memory.continue}
      state = %{state | callback: callback, chain: chain, timers: timers, pace: pace}
      inputs = Inputs.recall(state.inputs, memory.closed)
      {:ok, %{state | memory: nil, inputs: inputs}, memory.ended}
    end
  end

  defp callback(nil, nil, _path), do: {:ok, nil}

  defp callback(callback, snapshot, path) do
    with {:ok, core} <- Snapshot.put(callback.module, snapshot, callback.core, path),
         do: {:ok, %{callback | core: core}}
  end

  defp chain(nil, _steps, _path), do: {:ok, nil}

  defp chain(chain, steps, path) do
    fresh = for {:step, _fun, index, state} <- chain.steps, do: {index, state}

    with {:ok, steps} <- Snapshot.fill(steps, fresh, path) do
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
