defmodule Situ.Conformance.ZipMerge do
  import Situ.Conformance.Case
  alias Situ.Conformance.Run

  def check(%{"op" => op, "inputs" => []} = case),
    do: outputs(case, attempt(fn -> operator(op).([]) end))

  def check(%{"op" => op} = case) do
    result = Run.inputs(case, operator(op))
    result = if op == "merge", do: unwrapped(result), else: result
    outputs(case, result)
  end

  defp operator("zip"), do: &Situ.zip(&1)
  defp operator("merge"), do: &Situ.merge(&1)

  defp unwrapped({:ok, outputs}),
    do: {:ok, for({_, m} <- outputs, do: {m.originating_time, m.data})}

  defp unwrapped(error), do: error
end
