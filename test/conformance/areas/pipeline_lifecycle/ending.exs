defmodule Situ.Conformance.PipelineLifecycle.Ending do
  # How pipelines end: by their sources, by a stop, and what their handlers are told.
  import Situ.Conformance.Case, only: [all: 2, attempt: 1, ms: 1, outputs: 2]
  import Situ.Conformance.PipelineLifecycle.Telling
  alias Situ.Conformance.PipelineLifecycle.{Generator, Source}
  alias Situ.Conformance.Text
  alias Situ.Pipeline

  # The sources in a subpipeline: "finite, subpipeline(infinite)", "finite+infinite".
  @sources ~r/subpipeline(\((?:[^()]|(?1))*\))|[^,+()]+/

  def check(%{"op" => "completion", "params" => params} = case) do
    observe = min(params["observe_ms"] || 700, 700)
    {:ok, pid} = Pipeline.start(fn p -> Enum.each(params["sources"], &source(p, &1)) end, [])
    completed = match?({:ok, _}, Pipeline.await(pid, observe))
    unless completed, do: Pipeline.stop(pid)
    all(case, %{"completed" => completed})
  end

  def check(%{"op" => "dispose", "params" => %{"next_message_due_in_s" => s}} = case) do
    {:ok, pid} =
      Pipeline.start(
        fn p -> p |> Situ.source(Source, kind: {:later, ms(s * 1000)}) |> Situ.map(& &1) end,
        []
      )

    until_running(pid)
    {us, {:ok, _}} = :timer.tc(fn -> Pipeline.stop(pid) end)
    limit = case["expect"]["dispose_returns_within_ms"]

    all(case, %{"dispose_returns_within_ms" => if(us <= limit * 1000, do: limit, else: us / 1000)})
  end

  # As often and from as many processes as the case specifies, before it runs or while it is
  # running. A component has five outputs.
  def check(%{"op" => "dispose", "params" => params} = case) do
    p = Pipeline.new()

    for name <- components(params["components"]),
        do: Pipeline.add(p, Generator, tell: &Function.identity/1, gen: :endless, name: name)

    if params["pipeline"] == "running", do: :ok = Pipeline.launch(p)
    stops = for _ <- 1..times(params), do: Task.async(fn -> Pipeline.stop(p) end)
    # A subscriber after the end is notified that the pipeline has ended.
    {[{:ok, report} | _], late} =
      stops |> Task.await_many() |> Enum.split_with(&match?({:ok, _}, &1))

    [] = for {:error, %{code: code}} when code != :not_running <- late, do: code

    got = %{
      "state" => to_string(Pipeline.state(p)),
      "completed" => Pipeline.state(p) == :completed,
      "errors" => length(report.errors),
      "emitters_closed" => 5 * length(report.closed),
      "throws" => false,
      "exception" => nil
    }

    all(case, got)
  end

  def check(%{"op" => "events", "params" => %{"handler_takes_ms" => takes}} = case) do
    {tell, tag} = teller()

    {:ok, _} =
      Pipeline.run(fn p ->
        Situ.source(p, Source, kind: :finite)
        Pipeline.on(p, :completed, fn _ -> Process.sleep(takes) && tell.("Completed") end)
      end)

    tell.("Disposed")
    all(case, %{"order" => drain(tag)})
  end

  def check(%{"op" => "events"} = case) do
    {tell, tag} = teller()

    {:ok, _} =
      Pipeline.run(fn p ->
        Situ.source(p, Source, kind: :finite)
        Pipeline.on(p, :run, fn _ -> Pipeline.on(p, :run, fn _ -> tell.(:inner) end) end)
      end)

    all(case, %{"inner_handler_called" => drain(tag) == [:inner]})
  end

  def check(%{"op" => "run", "params" => %{"empty_sequences" => n}} = case) do
    result = Pipeline.run(fn p -> for _ <- 1..n, do: Situ.source(p, Situ.Component.Empty) end)

    all(case, %{"completed" => match?({:ok, _}, result), "errors" => errors(result)})
  end

  # The graph of a running pipeline cannot change.
  def check(%{"op" => "add_component"} = case) do
    p = Pipeline.new()
    Situ.source(p, Source, kind: :infinite)
    :ok = Pipeline.launch(p)
    result = attempt(fn -> Situ.from_enumerable(p, 0..9, every: 100) end)
    Pipeline.stop(p)
    outputs(case, result)
  end

  defp components(nil), do: ~w(A B C)
  defp components(n) when is_integer(n), do: Enum.map(1..n, &"Component#{&1}")
  defp components(names) when is_list(names), do: names
  defp components(other), do: Text.unknown!("components", other)

  # "threads", "times", "concurrent_calls" ...
  defp times(params) do
    Enum.find_value(params, 1, fn {key, n} ->
      is_integer(n) and key =~ ~r/thread|times|concurren|parallel|dispos|call/ and n
    end)
  end

  # Builds sources from their descriptions.

  defp source(p, "subpipeline(" <> rest) do
    # A subpipeline in a subpipeline keeps its own parenthesis.
    inner = rest |> String.replace_suffix(")", "") |> then(&Regex.scan(@sources, &1))

    Situ.composite(p, unique("Sub"), fn sub ->
      for [source | _] <- inner, do: source(sub, String.trim(source))
      :ok
    end)
  end

  defp source(p, text), do: Situ.source(p, Source, kind: kind(text))

  defp kind("finite"), do: :finite
  defp kind("infinite"), do: :infinite

  defp kind(text) do
    cond do
      text =~ "then" and text =~ "infinite" -> :becomes_infinite
      text =~ "never" or text =~ "pending" or text =~ "hang" -> :silent
      text =~ "infinite" -> :infinite
      true -> :finite
    end
  end

  defp errors({:ok, report}), do: length(report.errors)
  defp errors({:error, error}), do: length(error.meta.errors)

  defp unique(name), do: name <> Integer.to_string(System.unique_integer([:positive]))
end
