defmodule Situ.Conformance.PipelineLifecycle.Errors do
  # Errors in receivers, sources and handlers, and who is told about them.
  import Situ.Conformance.Case, only: [all: 2, error_fits?: 2, ms: 1]
  import Situ.Conformance.PipelineLifecycle.Telling
  alias Situ.Conformance.PipelineLifecycle.Source
  alias Situ.Pipeline

  def check(%{"op" => "error", "params" => params} = case) do
    {tell, tag} = teller()

    result =
      quietly(fn ->
        Pipeline.run(fn p ->
          Pipeline.on(p, :error, tell)
          stream = Situ.source(p, Source, kind: :finite)
          if params["receiver"], do: Situ.map(stream, &div(1, &1))
          if params["source_start"] || params["start"], do: Situ.source(p, Source, kind: :raises)

          if params["generator"] || params["source"],
            do: Situ.sequence(p, 0, &div(1, &1), every: ms(1), count: 2)

          inner =
            Situ.composite(p, "Sub", fn sub ->
              Situ.source(sub, Source, kind: :finite) && sub
            end)

          if params["run_event_handler"], do: Pipeline.on(p, :run, fn _ -> div(1, zero()) end)

          if params["subpipeline_run_event_handler"],
            do: Pipeline.on(inner, :run, fn _ -> div(1, zero()) end)
        end)
      end)

    failed(case, result, drain(tag))
  end

  # Returns the result of a run, and the argument of an error handler. A run does not raise: its
  # error is its result.
  defp failed(%{"expect_error" => name} = case, {:error, error}, _handled) do
    cond do
      not error_fits?(name, error) -> {:fail, {:error, name}, error}
      case["expect"] == nil -> :pass
      true -> all(case, %{})
    end
  end

  defp failed(%{"expect_error" => name}, result, _handled), do: {:fail, {:error, name}, result}

  defp failed(%{"expect" => %{} = expect} = case, result, handled) do
    all(
      case,
      Map.new(expect, fn {key, wanted} -> {key, answer(key, wanted, result, handled)} end)
    )
  end

  defp answer(key, wanted, result, handled) do
    cond do
      key =~ ~r/throw|raise/ ->
        if(wanted == nil, do: nil, else: false)

      key =~ ~r/completed|stopped|ended/ ->
        match?({_, _}, result)

      key =~ ~r/error|exception|handle/ and is_boolean(wanted) ->
        handled != []

      key =~ ~r/count|calls|times|errors/ and is_integer(wanted) ->
        length(handled)

      key =~ ~r/error|exception|handle|event|receive/ and is_binary(wanted) ->
        name(wanted, handled)

      key =~ ~r/error|exception/ and is_list(wanted) ->
        Enum.map(wanted, &name(&1, handled))

      true ->
        {:unread, key}
    end
  end

  defp name(wanted, handled),
    do: if(Enum.any?(handled, &error_fits?(wanted, &1)), do: wanted, else: handled)

  defp zero, do: String.length("")

  defp quietly(fun) do
    level = Logger.level()
    Logger.configure(level: :none)
    result = fun.()
    Logger.configure(level: level)
    result
  end
end
