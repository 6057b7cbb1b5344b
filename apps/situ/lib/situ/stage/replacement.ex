defmodule Situ.Stage.Replacement do
  @moduledoc false
  # Replaces the component or an operator of a step while it is running.
  alias Situ.{Error, Options}
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  alias Situ.Stage.Step

  @doc """
  Replaces the vertex at `index` of the stage. Returns the step and the actions of the new component, which are still to
  be applied. `{:keep, opts}` replaces only functions.
  """
  @spec replace(Step.t(), non_neg_integer(), module() | :operator, term()) ::
          {:ok, Step.t(), [Situ.Component.action()]} | {:error, Error.t()}
  def replace(%{worker: %Chain{} = chain} = step, index, :operator, new) do
    plain = with {:keep, plain} <- new, do: plain
    vertices = List.update_at(step.vertices, index - step.index, &%{&1 | opts: plain})
    {:ok, %{step | vertices: vertices, worker: Chain.replace_step(chain, index, new)}, []}
  end

  def replace(%{worker: worker} = step, _index, _module, {:keep, opts}) do
    with {:ok, worker} <- Callback.replace_functions(worker, opts),
         do: {:ok, Step.put_options(%{step | worker: worker}, opts), []}
  end

  def replace(step, _index, module, opts) do
    step = Step.read_clock(step)

    with {:ok, opts} <- Options.validate(opts, module.options()),
         {:ok, worker, actions} <-
           Callback.replace_component(step.worker, module, opts, step.context) do
      step = Step.update_head(%{step | worker: worker}, &%{&1 | module: module, opts: opts})
      {:ok, step, actions}
    end
  end
end
