defmodule Situ.Conformance.Statistics do
  import Situ.Conformance.Case
  alias Situ.Conformance.{Formula, Run, Text}

  # Applies a function to a list, without a stream.
  def check(%{"op" => op, "params" => %{"values" => values} = params, "inputs" => []} = case) do
    [name, "of_list"] = String.split(op, ".")

    result =
      attempt(fn -> Situ.Statistics.of_list(kind(name), value(values), options(params)) end)

    case {result, case} do
      {{:ok, result}, %{"expect" => expect}} ->
        verdict(value(expect), %{name => result}, tolerance(params))

      {result, case} ->
        outputs(case, result)
    end
  end

  def check(%{"op" => op, "params" => params} = case) do
    build = fn [stream] -> build(String.split(op, "."), stream, params) end
    outputs(case, Run.inputs(case, build), tolerance(params))
  end

  defp build(["delta"], stream, p), do: Situ.delta(stream, where(p))
  defp build(["abs"], stream, p), do: Situ.abs(stream, where(p))

  defp build(["log"], stream, %{"base" => base} = p),
    do: Situ.log(stream, [base: base] ++ where(p))

  defp build(["log"], stream, p), do: Situ.log(stream, where(p))

  defp build([name, form], stream, params) do
    opts = [over: over(form, params)] ++ options(params) ++ where(params)
    apply(Situ, kind(name), [stream, opts])
  end

  defp kind(name) do
    Map.fetch!(
      %{
        "count" => :count,
        "long_count" => :count,
        "sum" => :sum,
        "min" => :min,
        "max" => :max,
        "average" => :average,
        "std" => :std
      },
      name
    )
  end

  defp over("running", _params), do: :all
  defp over("of_list", _params), do: :list
  defp over("history", %{"size" => n}), do: {:last, n}
  defp over("history", %{"count" => n}), do: {:last, n}

  defp over("history", params),
    do: {:past, duration(params, "time") || Text.unknown!("a history", params)}

  # The running deviation of one decimal is 0, because decimals have no NaN.
  defp options(params) do
    nullable = if params["nullable"], do: [nullable: true], else: []
    compare = if compare = compare(params), do: [compare: compare], else: []
    initial = if params["type"] == "decimal", do: [initial: 0.0], else: []
    initial ++ nullable ++ compare
  end

  # The order of comparison, for values that are not numbers.
  defp compare(params) do
    case params["comparer"] || params["comparison"] || params["compare"] do
      nil ->
        nil

      text ->
        if(text =~ ~r/revers|descend|opposite|negat/,
          do: &>=/2,
          else: Text.unknown!("an order", text)
        )
    end
  end

  defp where(params) do
    case params["condition"] || params["predicate"] do
      nil -> []
      text -> [where: Formula.condition(text)]
    end
  end

  defp tolerance(%{"tolerance" => tolerance}), do: tolerance
  defp tolerance(%{"type" => "float32"}), do: 1.0e-6
  # The reference computes decimal deviations from 64-bit floats with 15 digits.
  defp tolerance(%{"type" => "decimal"}), do: 1.0e-12
  defp tolerance(_params), do: 1.0e-12
end
