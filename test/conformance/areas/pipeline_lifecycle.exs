Code.require_file("pipeline_lifecycle/components.exs", __DIR__)
Code.require_file("pipeline_lifecycle/telling.exs", __DIR__)
Code.require_file("pipeline_lifecycle/finalization.exs", __DIR__)
Code.require_file("pipeline_lifecycle/parts.exs", __DIR__)

defmodule Situ.Conformance.PipelineLifecycle do
  # Completion, stopping, errors, order of start and finalization, clock, progress, and
  # composites.
  import Situ.Conformance.Case,
    only: [all: 2, attempt: 1, error_fits?: 2, ms: 1, outputs: 2, told: 2]

  alias Situ.Pipeline
  import Situ.Conformance.PipelineLifecycle.Telling
  alias Situ.Conformance.PipelineLifecycle.{Finalization, Parts, Probe, Source, Ticker, Watch}

  @operations ~w(completion dispose events run error order clock progress finalization finalization_order
                 subpipeline composite connector add_component)

  def operation?(op), do: op in @operations

  def check(%{"op" => "completion", "params" => params} = case) do
    observe = min(params["observe_ms"], 700)
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
  # running.
  def check(%{"op" => "dispose", "params" => params} = case) do
    p = Pipeline.new()
    p |> Situ.source(Source, kind: :infinite) |> Situ.map(& &1)
    if params["pipeline"] == "running", do: :ok = Pipeline.launch(p)
    times = params["threads"] || params["times"] || params["concurrently"] || 1
    stops = for _ <- 1..times, do: Task.async(fn -> Pipeline.stop(p) end)
    # A subscriber after the end is notified that the pipeline has ended.
    {[{:ok, report} | _], late} =
      stops |> Task.await_many() |> Enum.split_with(&match?({:ok, _}, &1))

    [] = for {:error, %{code: code}} when code != :not_running <- late, do: code

    got = %{
      "state" => to_string(Pipeline.state(p)),
      "completed" => Pipeline.state(p) == :completed,
      "errors" => length(report.errors),
      "emitters_closed" => length(report.closed)
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

  def check(%{"op" => "order", "params" => %{"components" => names}} = case) do
    {tell, tag} = teller()

    {:ok, _} =
      Pipeline.run(fn p ->
        nodes = for name <- names, do: Pipeline.add(p, Probe, tell: tell, name: name)

        for {from, to} <- Enum.zip(nodes, tl(nodes) ++ [hd(nodes)]),
            do: Pipeline.connect(Situ.Node.output(from, :out), to, :in)
      end)

    events = drain(tag)
    starts = for {{:start, _}, i} <- Enum.with_index(events), do: i
    deliveries = for {{:delivery, _}, i} <- Enum.with_index(events), do: i

    in_order? =
      Enum.all?(names, fn name ->
        Enum.find_index(events, &(&1 == {:start, name})) <
          Enum.find_index(events, &(&1 == {:stop, name}))
      end)

    all(case, %{
      "all_starts_before_first_delivery" => Enum.max(starts) < Enum.min(deliveries),
      "each_start_before_its_stop" => in_order?
    })
  end

  # With enforcement, no message arrives before its time; without it, no message waits for its
  # time.
  def check(%{"op" => "clock", "params" => %{"count" => n, "interval_ms" => interval} = p} = case) do
    {tell, tag} = teller()
    now = Situ.Time.now()
    enforced? = p["enforce_replay_clock"] != false
    messages = for i <- 0..(n - 1), do: {now + i * ms(interval), i}
    replay = [interval: {now, :unbounded}, speed: if(enforced?, do: 1.0, else: :max)]

    {:ok, _} =
      Pipeline.run(
        fn p ->
          p
          |> Situ.source(Source, kind: {:messages, messages})
          |> Situ.each(fn _, m -> tell.({m.originating_time, Situ.Time.now()}) end)
        end,
        pipeline: [replay: replay]
      )

    [_ | rest] = got = drain(tag)

    each =
      told(case["expect"]["each_after_first"] || "", [
        {~r/delivery time >= originating time/, Enum.all?(rest, fn {t, at} -> at >= t end)},
        {~r/delivery time <= originating time/, Enum.all?(rest, fn {t, at} -> at <= t end)}
      ])

    all(case, %{"each_after_first" => each, "count" => length(got)})
  end

  # The clock as seen by a component inside a composite and by one outside it.
  def check(%{"op" => "clock"} = case) do
    {tell, tag} = teller()

    {:ok, _} =
      Pipeline.run(
        fn p ->
          Situ.source(p, Watch, tell: tell)
          Situ.composite(p, "Sub", &Situ.source(&1, Watch, tell: tell))
        end,
        pipeline: [replay: [interval: {1_000_000, :unbounded}, speed: 1.0]]
      )

    [{start, clock}, {inner_start, inner_clock}] = drain(tag)
    equal = fn a, b -> if a == b, do: "equal", else: "different" end

    all(case, %{
      "origin" => equal.(start, inner_start),
      "real_time_origin" => equal.(real(clock, start), real(inner_clock, inner_start)),
      "conversion" => equal.(real(clock, start + 12_345), real(inner_clock, inner_start + 12_345))
    })
  end

  def check(%{"op" => "progress", "id" => id} = case) do
    {:ok, pid} =
      Pipeline.start(
        fn p ->
          Situ.source(p, Ticker, interval: 10_000_000)

          if id =~ "sub",
            do: Situ.composite(p, "Sub", &Situ.source(&1, Ticker, interval: 10_000_000))
        end,
        []
      )

    until_running(pid)
    seen = for _ <- 1..6, do: Process.sleep(20) && Pipeline.progress(pid)
    {:ok, report} = Pipeline.stop(pid)
    all = seen ++ [report.snapshot.progress]

    running =
      told(case["expect"]["while_running"] || "", [
        {~r/< 1(?:\.0)?/, Enum.all?(seen, &(&1 < 1.0))}
      ])

    all(case, %{
      "never_decreases" => Enum.sort(all) == all,
      "final" => List.last(all),
      "while_running" => running
    })
  end

  def check(%{"op" => op} = case) when op in ["finalization", "finalization_order"],
    do: Finalization.check(case)

  def check(%{"op" => "composite"} = case), do: Parts.check(%{case | "op" => "subpipeline"})
  def check(%{"op" => op} = case) when op in ["subpipeline", "connector"], do: Parts.check(case)

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

  # The system time at which the pipeline's clock shows `time`, to the microsecond.
  defp real(%Situ.Clock{} = clock, time) do
    before = System.os_time()
    now = Situ.Clock.now(clock)
    div(before + (time - now), 50_000_000)
  end

  # Builds sources from their descriptions.

  defp source(p, "subpipeline(" <> rest) do
    inner = rest |> String.trim_trailing(")") |> String.split([",", "+"], trim: true)

    Situ.composite(p, unique("Sub"), fn sub ->
      Enum.each(inner, &source(sub, String.trim(&1)))
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

  defp zero, do: String.length("")

  defp unique(name), do: name <> Integer.to_string(System.unique_integer([:positive]))

  defp until_running(pid) do
    if Pipeline.state(pid) in [:building, :starting], do: until_running(pid), else: :ok
  end

  defp quietly(fun) do
    level = Logger.level()
    Logger.configure(level: :none)
    result = fun.()
    Logger.configure(level: level)
    result
  end
end
