for file <- ~w(telling components ending errors timing finalization parts),
    do: Code.require_file("pipeline_lifecycle/#{file}.exs", __DIR__)

defmodule Situ.Conformance.PipelineLifecycle do
  # Completion, stopping, errors, order of start and finalization, clock, progress, and
  # composites: maps each operation to the module that checks it.
  alias Situ.Conformance.PipelineLifecycle.{Ending, Errors, Finalization, Parts, Timing}

  @operations [
    {Ending, ~w(completion dispose events run add_component)},
    {Errors, ~w(error)},
    {Timing, ~w(order clock progress)},
    {Finalization, ~w(finalization finalization_order)},
    {Parts, ~w(subpipeline composite connector)}
  ]

  def operation?(op), do: checker(op) != nil

  def check(%{"op" => op} = case), do: checker(op).check(case)

  defp checker(op), do: Enum.find_value(@operations, fn {module, ops} -> op in ops && module end)
end
