Code.require_file("generators/sources.exs", __DIR__)

defmodule Situ.Conformance.Generators do
  import Situ.Conformance.Case
  import Situ.Conformance.Generators.Sources
  alias Situ.Conformance.{Facts, Run, Text}

  # Ticks from year 1 to the Unix epoch. The alignments of the reference count from year 1.
  @epoch_ticks 621_355_968_000_000_000

  # "pipeline_start_ticks", "start_time_ms", "latency_less_than_ms".
  @of_the_run ~r/^((?:pipeline_)?start(?:_time)?|latency_(?:less_than|below))_(ticks|us|ms|s)$/

  @refused "invalid_operation|out_of_order|originating_times?_not_(strictly_)?increasing"
  @not_increasing ~r/^(aggregate_pipeline_error\()?(#{@refused})\)?$/

  # The words before and after the comparison of a message's arrival with its own time.
  @arrival "(?:(?:the )?(?:last )?(?:creation|delivery|arrival|message)(?: time)?" <>
             "(?: of the last message)? )?(?:is )?"
  @own_time "(?: (?:its|the|last))* originating time"

  def operation?(op),
    do:
      Enum.all?(parts(op), fn {kind, _} -> kind in ~w(sequence range repeat return once timer) end)

  def check(%{"op" => "sequence." <> _, "params" => %{"items" => _}, "expect" => list} = case)
      when is_list(list),
      do: outputs(case, run(fn p -> items(p, case["params"]) end, case["params"]))

  # Times that are aligned.
  def check(%{"op" => op, "params" => params, "expect" => %{"each" => text}} = case) do
    [part] = parts(op)

    case run(fn p -> generator(part, p, params) end, params) do
      {:ok, outputs} ->
        count = params["count"] || length(outputs)
        known = %{"each" => each(text, outputs, params)}

        with :pass <- all(case, Facts.of(case["expect"], outputs, known)),
             do: verdict(count, length(outputs))

      error ->
        outputs(case, error)
    end
  end

  # Delivery in real time, or as fast as possible.
  def check(%{"params" => %{"enforce_replay_clock" => _}, "expect" => %{}} = case),
    do: paced(case)

  # The start of the pipeline and the latency of messages are known after a run only.
  def check(%{"expect" => %{} = expect} = case) when not is_map_key(expect, "stopped") do
    if Enum.any?(expect, fn {key, _} -> key =~ @of_the_run end),
      do: started_run(case),
      else: watched(case)
  end

  def check(%{"expect" => %{}} = case), do: watched(case)

  # The reference refuses an interval of 0 at its second message, as times that do not increase.
  # Situ refuses it when the pipeline is built.
  def check(%{"expect_error" => name, "params" => params} = case) do
    case {interval(params) > 0, run(build(case), params)} do
      {false, {:error, error}} when name != "argument_error" ->
        refused? = error_fits?("argument_error", error) and name =~ @not_increasing
        if refused?, do: :pass, else: outputs(case, {:error, error})

      {_, result} ->
        outputs(case, result)
    end
  end

  def check(case), do: outputs(case, run(build(case), case["params"]))

  defp build(%{"op" => op, "params" => params}),
    do: fn p -> op |> parts() |> Enum.map(&generator(&1, p, params)) |> hd() end

  # Advances the clock by a time. Returns whether the pipeline has ended, and its messages so far.
  defp watched(case) do
    case observation(case) do
      nil -> outputs(case, run(build(case), case["params"]))
      time -> observed(case, time)
    end
  end

  # Runs without a given start, which the source may propose.
  defp started_run(%{"params" => params, "expect" => expect} = case) do
    me = self()
    tag = make_ref()
    stream = build(case)
    given? = Enum.any?(params, fn {key, _} -> key =~ ~r/^replay_/ end)
    settings = if given?, do: [replay: [interval: replay(params)]], else: []

    {:ok, report} =
      Situ.Pipeline.run(
        fn p ->
          Situ.each(stream.(p), fn v, m ->
            send(me, {tag, {m.originating_time, v, Situ.Message.latency(m)}})
          end)
        end,
        pipeline: settings
      )

    arrived = drain(tag)
    outputs = for {time, v, _} <- arrived, do: {time, v}
    latest = arrived |> Enum.map(&elem(&1, 2)) |> Enum.max(fn -> 0 end)

    known =
      for {key, wanted} <- expect, [_, what, unit] <- [Regex.run(@of_the_run, key)], into: %{} do
        {key, of_the_run(what, wanted, Text.unit(unit), report.start_time, latest)}
      end

    all(case, Facts.of(expect, outputs, known))
  end

  defp of_the_run("latency" <> _, wanted, unit, _start, latest),
    do: if(latest < wanted * unit, do: wanted, else: latest / unit)

  defp of_the_run(_start, _wanted, unit, start, _latest), do: div(start, unit)

  # The time of observation is a parameter, or a part of the expectation ("stopped_within_ms").
  defp observation(%{"params" => params, "expect" => expect}) do
    Enum.find_value(~w(observe wait wait_all), &duration(params, &1)) ||
      Enum.find_value(expect, fn {key, _} ->
        key =~ ~r/within_(ms|s)$/ and max(0, duration(expect, String.replace(key, ~r/_m?s$/, "")))
      end)
  end

  defp observed(%{"params" => params, "expect" => expect} = case, time) do
    interval = replay(params)
    pipeline = if interval == {0, :unbounded}, do: [], else: [replay: [interval: interval]]
    # Generators that do not say more start at the time 0 of a clock that does not move by itself.
    parts = fn _, p -> for part <- parts(case["op"]), do: generator(part, p, params) end
    test = Situ.Test.start([], parts, start: elem(interval, 0), pipeline: pipeline)
    Situ.Test.advance(test, time)
    [outputs | _] = Situ.Test.outputs(test)
    ended? = Situ.Pipeline.state(test.pipeline) != :running
    Situ.Test.stop(test)
    all(case, Facts.of(expect, outputs, endings(expect, ended?, outputs)))
  end

  defp endings(expect, ended?, outputs) do
    for {key, wanted} <- expect, answer = ending(key, wanted, ended?, outputs), into: %{} do
      {key, elem(answer, 0)}
    end
  end

  defp ending(key, wanted, ended?, outputs) do
    cond do
      key =~ ~r/within_m?s$/ -> {if(ended? and wanted >= 0, do: wanted, else: :still_running)}
      key =~ ~r/^(stopped|completed|ended|stops|finished)/ -> {ended?}
      key =~ ~r/^(running|still_running|open)/ -> {not ended?}
      key =~ ~r/^first_\d+$/ and is_binary(wanted) -> {first(wanted, key, outputs)}
      true -> nil
    end
  end

  # A message's creation time here is the time of the pipeline's clock when the message arrives.
  defp paced(%{"params" => params, "expect" => expect} = case) do
    me = self()
    tag = make_ref()
    speed = if params["enforce_replay_clock"], do: 1.0, else: :max
    {start, stop} = replay(params)
    now = Situ.Time.now()
    start = if params["enforce_replay_clock"], do: start, else: now + start

    {:ok, report} =
      Situ.Pipeline.run(
        fn p ->
          Situ.each(build(case).(p), fn v, m ->
            send(me, {tag, {m.originating_time - start, v, arrival(speed, m) - start}})
          end)
        end,
        pipeline: [replay: [interval: {start, stop}, speed: speed]]
      )

    arrived = drain(tag)
    outputs = for {time, v, _} <- arrived, do: {time, v}

    known =
      for {key, text} when is_binary(text) <- expect,
          into: %{},
          do: {key, paced?(text, key, arrived)}

    known =
      if report.errors == [], do: known, else: Map.put(known, "errors", length(report.errors))

    all(case, Facts.of(expect, outputs, known))
  end

  defp arrival(:max, _message), do: Situ.Time.now()
  defp arrival(_speed, message), do: message.creation_time

  # "creation time >= originating time", "before its originating time".
  defp paced?(text, key, arrived) do
    arrived = if key =~ ~r/last/ or text =~ ~r/^last /, do: Enum.take(arrived, -1), else: arrived

    told(text, [
      {~r/#{@arrival}(?:>=|at or after|not before)#{@own_time}/,
       arrived != [] and Enum.all?(arrived, fn {time, _, at} -> at >= time end)},
      {~r/#{@arrival}(?:<|before)#{@own_time}/,
       arrived != [] and Enum.all?(arrived, fn {time, _, at} -> at < time end)}
    ])
  end

  defp drain(tag) do
    receive do
      {^tag, event} -> [event | drain(tag)]
    after
      0 -> []
    end
  end

  defp each(text, outputs, params) do
    all = fn fits? -> Enum.all?(outputs, fn {time, _} -> fits?.(time) end) end
    align = align(params)

    told(text, [
      {~r/.*multiple of (\d+) ?(ms|ticks|us|s)/,
       fn [n, unit] -> all.(&(Integer.mod(&1 - origin(align), unit(n, unit)) == 0)) end},
      {~r/originating_ticks mod (\d+) = (\d+)/,
       fn [n, rest] ->
         all.(
           &(Integer.mod(div(&1, 100) + @epoch_ticks, String.to_integer(n)) ==
               String.to_integer(rest))
         )
       end},
      {~r/.*(?:congruent|aligned|equal) to .*(?:modulo|mod) .*/,
       fn _ -> all.(&(Integer.mod(&1 - align, interval(params)) == 0)) end}
    ])
  end

  defp run(build, params) do
    Run.guarded(fn ->
      opts = [times: true, pipeline: [replay: [interval: replay(params), speed: :max]]]
      {:ok, Situ.to_list(build, opts)}
    end)
  end

  # "replay_end_ms", {"replay": {"end_ms": 100}} or "replay_interval_ms": [0, 100].
  defp replay(params) do
    for {"replay" <> _ = key, value} <- params,
        not (key =~ ~r/^replay$|^replay_(start|end|interval)_(ticks|us|ms|s)$/),
        do: Text.unknown!("a replay", {key, value})

    inner = if is_map(params["replay"]), do: params["replay"], else: %{}
    [from, to] = replay_interval(params) || [duration(inner, "start"), duration(inner, "end")]

    {duration(params, "replay_start") || from || 0,
     duration(params, "replay_end") || to || :unbounded}
  end

  defp replay_interval(params) do
    Enum.find_value(params, fn {key, ends} ->
      with [_, unit] <- Regex.run(~r/^replay_interval_(ticks|us|ms|s)$/, key),
           do: Enum.map(ends, &(&1 && &1 * Text.unit(unit)))
    end)
  end

  # The first messages as text: "t_ms = v = 0..399", "value 123 at t_ms 0..399".
  defp first(text, "first_" <> n, outputs) do
    outputs = Enum.take(outputs, String.to_integer(n))
    number = fn value -> with {n, ""} <- Integer.parse(value), do: n, else: (_ -> value) end

    told(text, [
      {~r/t_(ms|ticks|us|s) = v = (\d+)\.\.(\d+)/,
       fn [unit, from, to] -> outputs == row(unit, from, to, & &1) end},
      {~r/(\S+) at (\d+)\.\.(\d+) (ms|ticks|us|s)/,
       fn [value, from, to, unit] ->
         outputs == row(unit, from, to, fn _ -> number.(value) end)
       end},
      {~r/value (\S+) at t_(ms|ticks|us|s) (\d+)\.\.(\d+)/,
       fn [value, unit, from, to] ->
         outputs == row(unit, from, to, fn _ -> number.(value) end)
       end}
    ])
  end

  defp row(unit, from, to, value) do
    for n <- String.to_integer(from)..String.to_integer(to)//1, do: {unit(n, unit), value.(n)}
  end

  defp unit(n, unit) when is_binary(n), do: n |> String.to_integer() |> unit(unit)
  defp unit(n, unit), do: n * Text.unit(unit)

  # "A multiple of 10 ms" counts from year 1 in the reference, like alignments.
  defp origin(_align), do: ticks(-@epoch_ticks)
end
