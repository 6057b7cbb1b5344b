defmodule Situ.Conformance.PipelineLifecycle.Timing do
  # The order of starts and deliveries, the clock, and the progress of a pipeline.
  import Situ.Conformance.Case, only: [all: 2, duration: 2, ms: 1, told: 2]
  import Situ.Conformance.PipelineLifecycle.Telling
  alias Situ.Conformance.PipelineLifecycle.{Probe, Scopes, Source, Ticker, Watch}
  alias Situ.Pipeline

  # The components of a pipeline and of its subpipelines, connected as a ring in each of them.
  def check(%{"op" => "order", "params" => params} = case) do
    {tell, tag} = teller()
    groups = Scopes.groups(params)

    {:ok, _} =
      Pipeline.run(fn p ->
        for {scope, names} <- groups, names != [] do
          p = %{p | scope: scope}
          nodes = for name <- names, do: Pipeline.add(p, Probe, tell: tell, name: name)

          for {from, to} <- Enum.zip(nodes, tl(nodes) ++ [hd(nodes)]),
              do: Pipeline.connect(Situ.Node.output(from, :out), to, :in)
        end
      end)

    events = for {kind, path} <- drain(tag), do: {kind, path |> String.split(".") |> List.last()}
    at = fn kind, name -> Enum.find_index(events, &(&1 == {kind, name})) end

    all(case, %{
      "all_starts_before_first_delivery" =>
        Enum.all?(groups, fn {_, names} -> started_first?(names, at) end),
      "each_start_before_its_stop" =>
        Enum.all?(groups, fn {_, names} ->
          Enum.all?(names, &(at.(:start, &1) < at.(:stop, &1)))
        end)
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

    text = case["expect"]["each_after_first"] || case["expect"]["each"] || ""

    each =
      told(text, [
        {~r/delivery time >= originating time/, Enum.all?(rest, fn {t, at} -> at >= t end)},
        {~r/delivery time <= originating time/, Enum.all?(rest, fn {t, at} -> at <= t end)}
      ])

    all(case, %{"each_after_first" => each, "each" => each, "count" => length(got)})
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

  # Under a finite replay, the source is finite and ends the pipeline.
  def check(%{"op" => "progress", "params" => params} = case) do
    stop = duration(params, "replay_end")
    now = Situ.Time.now()
    settings = if stop, do: [pipeline: [replay: [interval: {now, now + stop}]]], else: []

    source =
      if stop,
        do: &Situ.repeat(&1, 0, every: ms(10)),
        else: &Situ.source(&1, Ticker, interval: ms(10))

    sub? = case["id"] =~ "sub" or params["subpipelines"] != nil

    {:ok, pid} =
      Pipeline.start(
        fn p ->
          source.(p)
          if sub?, do: Situ.composite(p, "Sub", source)
        end,
        settings
      )

    until_running(pid)
    seen = seen(pid, 6)
    {:ok, report} = if stop, do: Pipeline.await(pid, 30_000), else: Pipeline.stop(pid)
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

  # Every component of a group starts before any of them receives a message.
  defp started_first?([], _at), do: true

  defp started_first?(names, at) do
    starts = Enum.map(names, &at.(:start, &1))
    deliveries = Enum.map(names, &at.(:delivery, &1))
    nil not in (starts ++ deliveries) and Enum.max(starts) < Enum.min(deliveries)
  end

  # The system time at which the pipeline's clock shows `time`, to the microsecond.
  defp real(%Situ.Clock{} = clock, time) do
    before = System.os_time()
    now = Situ.Clock.now(clock)
    div(before + (time - now), 50_000_000)
  end

  # The progress, up to `n` times, until the pipeline has ended.
  defp seen(_pid, 0), do: []

  defp seen(pid, n) do
    Process.sleep(20)
    [Pipeline.progress(pid) | seen(pid, n - 1)]
  rescue
    Situ.Error -> []
  end
end
