defmodule Situ.Conformance.Operators do
  import Situ.Conformance.Case
  alias Situ.Conformance.{Facts, Formula, Run, Text}

  @operations ~w(to_enumerable to_observable subpipeline.passthrough first last select where edit_stream
                 time_of latency delay nullable_select item1 item2 flip event_source process do name bridge_to pipe_to)

  # The words around the comparison of a delay.
  @about_delays ~r/^(?:each |every )?(?:creation(?: time)? ?(?:-|minus) ?originating(?: time)?|latency|delay(?:ed)?)? ?(?:is |by )?|(?: (?:after|later than) (?:its|their|the) (?:creation|originating|original)(?: times?)?)$/

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
    all(case, Facts.of(case["expect"], outputs))
  end

  # Runs in real time until all messages have arrived. Checks their values and times, and that
  # none is earlier than its delay.
  def check(%{"op" => "delay", "params" => params, "expect" => expect} = case) do
    delay = delay(params)
    messages = given(case)
    {got, latencies} = delayed(messages, delay)

    if is_list(expect) do
      early = for latency <- latencies, latency < delay, do: latency
      with :pass <- outputs(case, {:ok, got}), do: verdict([], early)
    else
      known =
        for {key, wanted} <- expect,
            into: %{},
            do: {key, kept(key, wanted, messages, got, latencies)}

      all(case, Facts.of(expect, got, Map.reject(known, &match?({_, :other}, &1))))
    end
  end

  # Other processes post values, with or without conversion.
  def check(%{"op" => "event_source", "params" => params} = case) do
    me = self()
    formula = Enum.find_value(~w(function converter convert conversion), &params[&1])
    convert = if formula, do: Formula.of_one(formula), else: & &1
    events = Text.range(params["events"] || params["posted"] || params["posts"]) || posted(case)

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
    event_outcome(case, got, unsubscribed?)
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

  defp delay(params) do
    found = Enum.find_value(~w(delay by duration span), &duration(params, &1))
    found || Text.duration!(params["delay"] || Text.unknown!("a delay", params))
  end

  # The messages of the only input, or `count` numbers at an interval.
  defp given(%{"inputs" => [%{"messages" => messages}]}), do: timed(messages)

  defp given(%{"inputs" => [], "params" => %{"count" => count} = params}) do
    every = duration(params, "interval") || ms(1)
    for i <- 0..(count - 1)//1, do: {i * every, i}
  end

  # Answers what a case says about delays, or :other. The delay is a number of the key's unit, or a
  # comparison with its unit: "latency >= 50 ms", "at least 50 ms after its creation".
  defp kept(key, wanted, messages, got, latencies) do
    cond do
      key =~ ~r/^times_kept$|^originating_times?$/ and not is_list(wanted) ->
        if is_boolean(wanted),
          do: got == messages,
          else: meant(wanted, ~r/same|unchanged|kept|equal|own/, got == messages)

      key =~ ~r/delay|latenc|creation|each|every/ ->
        late(key, wanted, latencies)

      true ->
        :other
    end
  end

  defp late(key, wanted, latencies) when is_number(wanted) do
    least = duration(%{key => wanted}, Regex.replace(~r/_[a-z]+$/, key, ""))
    least = least || Text.unknown!("the unit of a delay", key)
    if latencies != [] and Enum.min(latencies) >= least, do: wanted, else: latencies
  end

  defp late(key, wanted, latencies) when is_binary(wanted) do
    unit = with [_, unit] <- Regex.run(~r/_(ticks|us|ms|s)$/, key), do: " " <> unit
    plain = Regex.replace(@about_delays, wanted, "")
    plain = if unit && plain =~ ~r/\d$/, do: plain <> unit, else: plain
    fits = Enum.map(latencies, &Text.compare(plain, &1, ns: true))

    cond do
      fits == [] or nil in fits -> {:unread, wanted}
      Enum.all?(fits) -> wanted
      true -> {:not_so, wanted, latencies}
    end
  end

  defp late(_key, wanted, _latencies), do: {:unread, wanted}

  defp posted(%{"inputs" => inputs}), do: for(i <- inputs, m <- i["messages"], do: m["v"])

  # The handler is gone after the pipeline has stopped: "unsubscribed" is true, a number of handlers
  # 0, and a handler null or false.
  defp event_outcome(%{"expect" => %{} = expect} = case, got, unsubscribed?) do
    known =
      for {key, wanted} <- expect, key =~ ~r/subscri|handler|detach|attached/, into: %{} do
        cond do
          key =~ ~r/unsubscri|detach|removed/ -> {key, unsubscribed?}
          is_integer(wanted) -> {key, if(unsubscribed?, do: 0, else: 1)}
          is_nil(wanted) -> {key, if(unsubscribed?, do: nil, else: :attached)}
          true -> {key, not unsubscribed?}
        end
      end

    all(case, Facts.of(expect, Enum.map(got, &{0, &1}), known))
  end

  defp event_outcome(%{"expect" => [%{"v" => _} | _] = messages}, got, _unsubscribed?),
    do: verdict(Enum.map(messages, & &1["v"]), got)

  defp event_outcome(%{"expect" => values}, got, _unsubscribed?), do: verdict(values, got)

  defp nested(stream, 0, _extra), do: stream

  defp nested(stream, depth, extra) do
    Situ.composite(stream, "Level#{depth}", fn inner ->
      if extra == :infinite,
        do: Situ.repeat(inner.pipeline, :tick, every: Situ.Time.ms(1), name: "Endless")

      if extra == :finite, do: Situ.return(inner.pipeline, :tick, name: "Once")
      inner |> Situ.map(& &1) |> nested(depth - 1, extra)
    end)
  end

  # Applies an operation, also as the branch of a parallel operator. With a seed, an optional
  # selector computes the output from the state.
  def build("aggregate" <> _, stream, %{"function" => text} = params) do
    fun = Formula.of_two(text)

    if seed = params["seed"] || params["initial"] do
      state = Situ.scan(stream, seed, fn data, previous -> fun.(previous, data) end)
      if params["selector"], do: Situ.map(state, Formula.of_one(params["selector"])), else: state
    else
      Situ.reduce(stream, fn data, previous -> fun.(previous, data) end)
    end
  end

  def build("first", stream, params), do: Situ.first(stream, params["count"] || 1)
  def build("last", stream, params), do: Situ.last(stream, params["count"] || 1)

  def build("select", stream, %{"function" => "running average" <> _}) do
    Situ.scan(stream, {0, 0}, fn value, {sum, n} -> {sum + value, n + 1} end)
    |> Situ.map(fn {sum, n} -> sum / n end)
  end

  def build("select", stream, %{"function" => text}) do
    Situ.map(stream, Formula.of_one(text))
  end

  def build("where", stream, params), do: Situ.filter(stream, condition(params))

  def build("edit_stream", stream, params) do
    edits =
      for edit <- params["edits"] do
        if edit["delete"],
          do: {time(edit), :delete},
          else: {time(edit), {:put, value(edit["upsert"])}}
      end

    Situ.edit(stream, edits)
  end

  def build("time_of", stream, _params), do: Situ.time_of(stream)

  def build("latency", stream, _params), do: Situ.latency(stream)
  def build("delay", stream, params), do: Situ.delay(stream, delay(params))

  def build("nullable_select", stream, p),
    do: Situ.map_present(stream, Formula.of_one(p["function"]))

  def build("item1", stream, _params), do: Situ.map(stream, &hd/1)
  def build("item2", stream, _params), do: Situ.map(stream, &Enum.at(&1, 1))
  def build("flip", stream, _params), do: Situ.map(stream, fn [a, b] -> [b, a] end)

  # Repeats every input, with the k-th copy k ticks later.
  def build("process", stream, params) do
    copies = params["outputs_per_input"] || 1
    fun = Formula.of_one(params["function"] || "v")

    Situ.process(stream, nil, fn message, state ->
      outputs =
        for k <- 0..(copies - 1)//1, do: {message.originating_time + ticks(k), fun.(message.data)}

      {outputs, state}
    end)
  end

  def build(op, stream, params)
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
end
