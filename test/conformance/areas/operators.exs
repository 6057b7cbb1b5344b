defmodule Situ.Conformance.Operators do
  import Situ.Conformance.Case
  alias Situ.Conformance.{Formula, Run}

  @operations ~w(to_enumerable to_observable subpipeline.passthrough first last select where edit_stream
                 time_of latency delay nullable_select item1 item2 flip event_source process do name bridge_to pipe_to)

  # Alternative names of the same operators.
  @aliases %{"observable" => "to_observable", "enumerable" => "to_enumerable"}

  def operation?(op) do
    op in @operations or Map.has_key?(@aliases, op) or String.starts_with?(op, "aggregate")
  end

  def check(%{"op" => op} = case) when is_map_key(@aliases, op),
    do: check(%{case | "op" => @aliases[op]})

  def check(%{"op" => "to_enumerable", "params" => params, "inputs" => [input]} = case) do
    keep = condition(params)
    items = timed(input["messages"])
    messages = Situ.to_stream(&Situ.from_enumerable(&1, items), messages: true)
    got = for m <- Enum.take_while(messages, &keep.(&1.data)), do: {m.originating_time, m.data}
    outputs(case, {:ok, got})
  end

  def check(%{"op" => "to_observable", "params" => %{"steps" => steps}, "expect" => expect}) do
    test = Situ.Test.start([:in], fn %{in: stream} -> Situ.map(stream, & &1, name: "Out") end)

    {answers, _taps} =
      Enum.reduce(steps, {[], []}, fn
        "subscribe", {answers, taps} ->
          {:ok, tap} = Situ.attach_tap({test.pipeline, "Out"}, &Function.identity/1)
          {answers, [tap | taps]}

        "unsubscribe", {answers, [tap | taps]} ->
          :ok = Situ.detach_tap(tap)
          {answers, taps}

        "has_subscribers", {answers, taps} ->
          nodes = Situ.Pipeline.info(test.pipeline).nodes
          {[Enum.any?(nodes, &(&1.kind == :tap)) | answers], taps}
      end)

    Situ.Test.stop(test)
    verdict(expect, %{"has_subscribers" => Enum.reverse(answers)})
  end

  # An observer receives every value, and then the end.
  def check(%{"op" => "to_observable", "inputs" => [_ | _], "expect" => %{}} = case) do
    {:ok, outputs} = Run.inputs(case, fn [stream] -> Situ.each(stream, & &1) end)
    values = Enum.map(outputs, &elem(&1, 1))

    all(case, %{
      "values" => values,
      "received" => values,
      "on_next" => values,
      "count" => length(values),
      "completed" => true,
      "on_completed" => true,
      "on_error" => false
    })
  end

  # Runs in real time until all messages have arrived. Checks their values and times, and that
  # none is earlier than its delay.
  def check(%{"op" => "delay", "params" => params} = case) do
    delay = duration(params, "delay")
    [%{"messages" => messages}] = case["inputs"]
    {got, latencies} = delayed(timed(messages), delay)
    late = for latency <- latencies, latency < delay, do: latency

    case case["expect"] do
      list when is_list(list) ->
        with :pass <- outputs(case, {:ok, got}), do: verdict([], late)

      expect ->
        all(case, %{
          "count" => length(got),
          "values" => Enum.map(got, &elem(&1, 1)),
          "received" => Enum.map(got, &elem(&1, 1)),
          "times_kept" => got == timed(messages),
          "min_latency_ms" => min_latency(expect["min_latency_ms"], latencies),
          "each_delayed_at_least_ms" =>
            min_latency(expect["each_delayed_at_least_ms"], latencies),
          "each" => each(expect["each"], latencies),
          "latency" => each(expect["latency"], latencies)
        })
    end
  end

  # Other processes post values, with or without conversion.
  def check(%{"op" => "event_source", "params" => params} = case) do
    me = self()
    convert = if f = params["function"] || params["converter"], do: Formula.of_one(f), else: & &1

    events =
      params["events"] || params["posted"] ||
        for(i <- case["inputs"], m <- i["messages"], do: m["v"])

    {:ok, pipeline} =
      Situ.Pipeline.start(
        fn p ->
          p
          |> Situ.event_source(&send(me, {:post, &1}),
            unsubscribe: fn _ -> send(me, :unsubscribed) end
          )
          |> Situ.each(&send(me, {:value, &1}))
        end,
        []
      )

    post = receive do: ({:post, post} -> post)
    for event <- events, do: post.(convert.(event))
    got = for _ <- events, do: receive(do: ({:value, value} -> value))
    {:ok, _} = Situ.Pipeline.stop(pipeline)
    unsubscribed? = receive do: (:unsubscribed -> true), after: (0 -> false)

    case case["expect"] do
      %{} = expect ->
        all = %{"values" => got, "received" => got, "unsubscribed" => unsubscribed?}
        verdict(expect, Map.take(all, Map.keys(expect)))

      [%{"v" => _} | _] = messages ->
        verdict(Enum.map(messages, & &1["v"]), got)

      values ->
        verdict(values, got)
    end
  end

  def check(%{"op" => "subpipeline.passthrough", "params" => params} = case) do
    extra = params["extra_sources"] || "none"
    extra = if extra =~ "infinite", do: :infinite, else: if(extra =~ "finite", do: :finite)

    outputs(
      case,
      Run.inputs(case, fn [stream] -> nested(stream, params["depth"] || 1, extra) end)
    )
  end

  def check(%{"op" => op, "params" => params} = case),
    do: outputs(case, Run.inputs(case, fn [stream] -> build(op, stream, params) end))

  defp delayed(messages, delay) do
    me = self()
    last = messages |> Enum.map(&elem(&1, 0)) |> Enum.max(fn -> 0 end)

    {:ok, pipeline} =
      Situ.Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(messages, keep_open: true)
          |> Situ.delay(delay)
          |> Situ.process(nil, fn message, state ->
            send(
              me,
              {:delayed, message.originating_time, message.data, Situ.Message.latency(message)}
            )

            {[], state}
          end)
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: 1.0]]
      )

    wait = div(last + delay, 1_000_000) + 2_000

    came =
      for _ <- messages,
          do: receive(do: ({:delayed, t, v, l} -> {t, v, l}), after: (wait -> :missing))

    Situ.Pipeline.stop(pipeline)
    came = Enum.reject(came, &(&1 == :missing))
    {for({t, v, _} <- came, do: {t, v}), for({_, _, latency} <- came, do: latency)}
  end

  defp min_latency(nil, _latencies), do: nil

  defp min_latency(n, latencies),
    do: if(Enum.all?(latencies, &(&1 >= ms(n))), do: n, else: latencies)

  # "at least 50 ms after its creation", "latency >= 50 ms".
  defp each(nil, _latencies), do: nil

  defp each(text, latencies) do
    told(text, [
      {~r/.*(?:at least|>=|not before) ?(\d+) ?ms.*/,
       fn [n] -> Enum.all?(latencies, &(&1 >= ms(String.to_integer(n)))) end}
    ])
  end

  defp nested(stream, 0, _extra), do: stream

  defp nested(stream, depth, extra) do
    Situ.composite(stream, "Level#{depth}", fn inner ->
      if extra == :infinite,
        do: Situ.repeat(inner.pipeline, :tick, every: Situ.Time.ms(1), name: "Endless")

      if extra == :finite, do: Situ.return(inner.pipeline, :tick, name: "Once")
      inner |> Situ.map(& &1) |> nested(depth - 1, extra)
    end)
  end

  # With a seed, an optional selector computes the output from the state.
  defp build("aggregate" <> _, stream, %{"function" => text} = params) do
    fun = Formula.of_two(text)

    if seed = params["seed"] || params["initial"] do
      state = Situ.scan(stream, seed, fn data, previous -> fun.(previous, data) end)
      if params["selector"], do: Situ.map(state, Formula.of_one(params["selector"])), else: state
    else
      Situ.reduce(stream, fn data, previous -> fun.(previous, data) end)
    end
  end

  defp build("first", stream, params), do: Situ.first(stream, params["count"] || 1)
  defp build("last", stream, params), do: Situ.last(stream, params["count"] || 1)

  defp build("select", stream, %{"function" => "running average" <> _}) do
    Situ.scan(stream, {0, 0}, fn value, {sum, n} -> {sum + value, n + 1} end)
    |> Situ.map(fn {sum, n} -> sum / n end)
  end

  defp build("select", stream, %{"function" => text}) do
    Situ.map(stream, Formula.of_one(text))
  end

  defp build("where", stream, params), do: Situ.filter(stream, condition(params))

  defp build("edit_stream", stream, params) do
    edits =
      for edit <- params["edits"] do
        if edit["delete"],
          do: {time(edit), :delete},
          else: {time(edit), {:put, value(edit["upsert"])}}
      end

    Situ.edit(stream, edits)
  end

  defp build("time_of", stream, _params), do: Situ.time_of(stream)

  defp build("latency", stream, _params), do: Situ.latency(stream)
  defp build("delay", stream, params), do: Situ.delay(stream, duration(params, "delay"))

  defp build("nullable_select", stream, p),
    do: Situ.map_present(stream, Formula.of_one(p["function"]))

  defp build("item1", stream, _params), do: Situ.map(stream, &hd/1)
  defp build("item2", stream, _params), do: Situ.map(stream, &Enum.at(&1, 1))
  defp build("flip", stream, _params), do: Situ.map(stream, fn [a, b] -> [b, a] end)

  # Repeats every input, with the k-th copy k ticks later.
  defp build("process", stream, params) do
    copies = params["outputs_per_input"] || 1
    fun = Formula.of_one(params["function"] || "v")

    Situ.process(stream, nil, fn message, state ->
      outputs =
        for k <- 0..(copies - 1)//1, do: {message.originating_time + ticks(k), fun.(message.data)}

      {outputs, state}
    end)
  end

  defp build(op, stream, params)
       when op in ["to_observable", "do", "name", "bridge_to", "pipe_to"] do
    if params["function"],
      do: stream |> Situ.map(Formula.of_one(params["function"])) |> Situ.each(& &1),
      else: Situ.each(stream, & &1)
  end

  defp condition(params) do
    case params["condition"] || params["predicate"] || params["function"] do
      nil -> fn _ -> true end
      text -> Formula.condition(text)
    end
  end

  defp duration(params, key),
    do: if(n = params[key <> "_ms"], do: ms(n), else: ticks(params[key <> "_ticks"]))
end
