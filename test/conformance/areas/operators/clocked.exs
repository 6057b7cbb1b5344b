defmodule Situ.Conformance.Operators.Clocked do
  # Operators that depend on the system's clock: delays, and events of other processes.
  import Situ.Conformance.Case
  alias Situ.Conformance.{Facts, Formula, Text}

  # The words around the comparison of a delay.
  @delay "creation(?: time)?(?: of (?:the |each )?(?:output|message))?" <>
           "(?: ?(?:-|minus) ?originating(?: time)?)?|latency|delay(?:ed)?|delivered"
  @before "^(?:each |every )?(?:#{@delay})? ?(?:is |by )?"
  @times "(?:creation|originating|original)(?: times?)?"
  @behind " (?:after|later than) (?:its|their|the) #{@times}$| for (?:every|each) message$"
  @about_delays ~r/#{@before}|#{@behind}/

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

  def delay(params) do
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

      key =~ ~r/delay|latenc|creation|each|every|property/ ->
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
end
