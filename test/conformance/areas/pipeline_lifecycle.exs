defmodule Situ.Conformance.PipelineLifecycle do
  # Completion, stopping, errors, order of start and of finalisation, clock, progress, composites.
  import Situ.Conformance.Case, only: [attempt: 1, outputs: 2, verdict: 2, timed: 1, ms: 1]
  alias Situ.Conformance.Formula
  alias Situ.Pipeline

  defmodule Source do
    # Says what it is told to say, when it is told to.
    use Situ.Component, outputs: [out: :any], options: [kind: [type: :any], tell: [type: :any]]

    @impl true
    def handle_start(context, opts), do: {start(opts[:kind], context), opts}

    @impl true
    def handle_info({:timer, actions}, _context, opts), do: {actions, opts}

    defp start(:finite, context),
      do: [{:out, context.start_time, 0}, {:complete, context.start_time}]

    defp start(:infinite, _context), do: [{:complete, :infinity}]
    defp start(:raises, context), do: [{:out, context.start_time, div(1, context.start_time * 0)}]
    defp start(:silent, _context), do: []

    defp start(:becomes_infinite, context),
      do: [{:timer, [{:complete, :infinity}], context.start_time + 50_000_000}]

    defp start({:messages, messages}, _context) do
      {last, _} = List.last(messages)
      for({time, v} <- messages, do: {:out, time, v}) ++ [{:complete, last}]
    end

    defp start({:later, delay}, context),
      do: [{:out, context.start_time + delay, 0}, {:complete, :infinity}]
  end

  defmodule Ticker do
    # A timer without end: 1, 2, 3 ...
    use Situ.Component, outputs: [out: :integer], options: [interval: [type: :pos_integer]]

    @impl true
    def init(opts), do: {:ok, {opts[:interval], 0}}

    @impl true
    def handle_start(context, state),
      do: {[{:complete, :infinity}, next(context.start_time, state)], state}

    @impl true
    def handle_info({:timer, time}, _context, {interval, n}),
      do: {[{:out, time, n + 1}, next(time, {interval, n})], {interval, n + 1}}

    defp next(time, {interval, _}), do: {:timer, time + interval, time + interval}
  end

  defmodule Relay do
    # Relays x to any and x, y to any and y, z to any and z; each output at its own, ever later times.
    use Situ.Component,
      inputs: [x: {:any, optional: true}, y: {:any, optional: true}, z: {:any, optional: true}],
      outputs: [any: :any, x: :any, y: :any, z: :any, gen: :any],
      options: [
        tell: [type: :any, required: true],
        gen: [type: :boolean, default: false],
        at_close: [type: :any]
      ]

    @tick 100

    @impl true
    def init(opts),
      do: {:ok, %{tell: opts[:tell], last: %{}, at_close: opts[:at_close], gen: opts[:gen]}}

    @impl true
    def handle_start(context, %{gen: true} = state) do
      times = for n <- 1..3, do: context.start_time + n * 1_000_000
      {Enum.map(times, &{:gen, &1, 0}) ++ [{:complete, List.last(times)}], state}
    end

    def handle_start(_context, state), do: {[], state}

    @impl true
    def handle_message(input, message, context, state) do
      state.tell.({:received, context.path, input})
      {any, state} = later(state, :any, message)
      {same, state} = later(state, input, message)
      {[{:any, any, message.data}, {input, same, message.data}], state}
    end

    @impl true
    def handle_closed(input, _time, context, state) do
      state.tell.({:closed, context.path, input})
      if state.at_close, do: Situ.Pipeline.stop(context.pipeline)
      {[], state}
    end

    defp later(state, output, message) do
      time =
        max(Map.get(state.last, output, message.originating_time), message.originating_time) +
          @tick

      {time, put_in(state.last[output], time)}
    end
  end

  defmodule Generator do
    # A relay that is a source besides: what it generates makes the pipeline end.
    use Situ.Component,
      inputs: [x: {:any, optional: true}, y: {:any, optional: true}, z: {:any, optional: true}],
      outputs: [any: :any, x: :any, y: :any, z: :any, gen: :any],
      options: [
        tell: [type: :any, required: true],
        gen: [type: :boolean, default: true],
        at_close: [type: :any]
      ]

    @impl true
    defdelegate init(opts), to: Relay
    @impl true
    defdelegate handle_start(context, state), to: Relay
    @impl true
    defdelegate handle_message(input, message, context, state), to: Relay
    @impl true
    defdelegate handle_closed(input, time, context, state), to: Relay

    @impl true
    def handle_demand(_n, _context, state), do: {[], state}
  end

  defmodule Probe do
    # Tells of every callback it sees.
    use Situ.Component,
      inputs: [in: {:any, optional: true}],
      outputs: [out: :any],
      options: [tell: [type: :any], posts: [type: :boolean, default: true]]

    @impl true
    def handle_start(context, opts) do
      opts[:tell].({:start, context.path})
      {[{:out, context.start_time, 1}, {:complete, context.start_time}], opts}
    end

    @impl true
    def handle_demand(_n, _context, opts), do: {[], opts}

    @impl true
    def handle_message(:in, _message, context, opts) do
      opts[:tell].({:delivery, context.path})
      {[], opts}
    end

    @impl true
    def handle_stop(_final, context, opts) do
      opts[:tell].({:stop, context.path})
      {[], opts}
    end
  end

  @operations ~w(completion dispose events run error order clock progress finalization finalization_order subpipeline connector add_component)

  def operation?(op), do: op in @operations

  def check(%{"op" => "completion", "params" => params} = case) do
    observe = min(params["observe_ms"], 700)
    {:ok, pid} = Pipeline.start(fn p -> Enum.each(params["sources"], &source(p, &1)) end, [])
    completed = match?({:ok, _}, Pipeline.await(pid, observe))
    unless completed, do: Pipeline.stop(pid)
    verdict(case["expect"], %{"completed" => completed})
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
    if us <= limit * 1000, do: :pass, else: {:fail, limit, us / 1000}
  end

  # As often and from as many processes as the case says, before it ran or while it runs.
  def check(%{"op" => "dispose", "params" => params} = case) do
    p = Pipeline.new()
    p |> Situ.source(Source, kind: :infinite) |> Situ.map(& &1)
    if params["pipeline"] == "running", do: :ok = Pipeline.start(p)
    times = params["threads"] || params["times"] || params["concurrently"] || 1
    stops = for _ <- 1..times, do: Task.async(fn -> Pipeline.stop(p) end)
    # Whoever comes when all is over is told so.
    {[{:ok, report} | _], late} =
      stops |> Task.await_many() |> Enum.split_with(&match?({:ok, _}, &1))

    [] = for {:error, %{code: code}} when code != :not_running <- late, do: code

    got = %{
      "state" => to_string(Pipeline.state(p)),
      "completed" => Pipeline.state(p) == :completed,
      "errors" => length(report.errors),
      "emitters_closed" => length(report.closed)
    }

    verdict(case["expect"], Map.take(got, Map.keys(case["expect"])))
  end

  def check(%{"op" => "events", "params" => %{"handler_takes_ms" => takes}} = case) do
    {tell, tag} = teller()

    {:ok, _} =
      Pipeline.run(fn p ->
        Situ.source(p, Source, kind: :finite)
        Pipeline.on(p, :completed, fn _ -> Process.sleep(takes) && tell.("Completed") end)
      end)

    tell.("Disposed")
    verdict(case["expect"], %{"order" => drain(tag)})
  end

  def check(%{"op" => "events"} = case) do
    {tell, tag} = teller()

    {:ok, _} =
      Pipeline.run(fn p ->
        Situ.source(p, Source, kind: :finite)
        Pipeline.on(p, :run, fn _ -> Pipeline.on(p, :run, fn _ -> tell.(:inner) end) end)
      end)

    verdict(case["expect"], %{"inner_handler_called" => drain(tag) == [:inner]})
  end

  def check(%{"op" => "run", "params" => %{"empty_sequences" => n}} = case) do
    result = Pipeline.run(fn p -> for _ <- 1..n, do: Situ.source(p, Situ.Pipeline.Empty, []) end)

    verdict(case["expect"], %{"completed" => match?({:ok, _}, result), "errors" => errors(result)})
  end

  # The graph of a running pipeline is fixed.
  def check(%{"op" => "add_component"} = case) do
    p = Pipeline.new()
    Situ.source(p, Source, kind: :infinite)
    :ok = Pipeline.start(p)
    result = attempt(fn -> Situ.range(p, 0, 10, 100) end)
    Pipeline.stop(p)
    outputs(case, result)
  end

  def check(%{"op" => "error", "params" => params} = case) do
    result =
      quietly(fn ->
        Pipeline.run(fn p ->
          stream = Situ.source(p, Source, kind: :finite)
          if params["receiver"], do: Situ.map(stream, &div(1, &1))
          if params["source_start"] || params["start"], do: Situ.source(p, Source, kind: :raises)

          if params["generator"] || params["source"],
            do: Situ.sequence(p, 0, &div(1, &1), ms(1), count: 2)

          inner =
            Pipeline.composite(p, "Sub", fn sub ->
              Situ.source(sub, Source, kind: :finite) && sub
            end)

          if params["run_event_handler"], do: Pipeline.on(p, :run, fn _ -> div(1, zero()) end)

          if params["subpipeline_run_event_handler"],
            do: Pipeline.on(inner, :run, fn _ -> div(1, zero()) end)
        end)
      end)

    case result do
      {:error, %{meta: %{exception: %ArithmeticError{}, errors: [_ | _]}}} -> :pass
      {:error, %{meta: %{errors: [%{meta: %{exception: %ArithmeticError{}}} | _]}}} -> :pass
      other -> {:fail, case["expect_error"], other}
    end
  end

  def check(%{"op" => "order", "params" => %{"components" => names}} = case) do
    {tell, tag} = teller()

    {:ok, _} =
      Pipeline.run(fn p ->
        nodes = for name <- names, do: Pipeline.add(p, Probe, [tell: tell], name: name)

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

    verdict(case["expect"], %{
      "all_starts_before_first_delivery" => Enum.max(starts) < Enum.min(deliveries),
      "each_start_before_its_stop" => in_order?
    })
  end

  # Enforced, nothing comes before its time; not enforced, nothing waits for it.
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
    in_time? = fn {t, at} -> if enforced?, do: at >= t, else: at <= t end
    ok? = length(got) == case["expect"]["count"] and Enum.all?(rest, in_time?)
    if ok?, do: :pass, else: {:fail, case["expect"], got}
  end

  def check(%{"op" => "clock"} = case) do
    {:ok, pid} =
      Pipeline.start(fn p -> {p, Pipeline.composite(p, "Sub", fn sub -> sub end)} end,
        pipeline: [replay: [interval: {0, :unbounded}]]
      )

    until_running(pid)
    clock = Pipeline.clock(pid)
    Pipeline.stop(pid)
    # A composite is a name for a group: there is one clock.
    if match?(%Situ.Clock{kind: :virtual}, clock), do: :pass, else: {:fail, case["expect"], clock}
  end

  def check(%{"op" => "progress", "id" => id} = case) do
    {:ok, pid} =
      Pipeline.start(
        fn p ->
          Situ.source(p, Ticker, interval: 10_000_000)

          if id =~ "sub",
            do: Pipeline.composite(p, "Sub", &Situ.source(&1, Ticker, interval: 10_000_000))
        end,
        []
      )

    until_running(pid)
    seen = for _ <- 1..6, do: Process.sleep(20) && Pipeline.progress(pid)
    {:ok, report} = Pipeline.stop(pid)
    all = seen ++ [report.snapshot.progress]

    if Enum.sort(all) == all and List.last(all) == 1.0 and Enum.all?(seen, &(&1 < 1.0)),
      do: :pass,
      else: {:fail, case["expect"], all}
  end

  def check(%{"op" => "finalization"} = case) do
    {tell, tag} = teller()
    messages = for i <- 0..9, do: {i * 1000, i}

    {:ok, _} =
      Pipeline.run(stopping(tell, messages), pipeline: [replay: [interval: {0, :unbounded}]])

    received = for v when is_integer(v) <- drain(tag), do: v
    verdict(case["expect"], %{"received" => received, "deadlock" => false})
  end

  def check(%{"op" => "finalization_order", "params" => params} = case) do
    {tell, tag} = teller()
    {:ok, report} = Pipeline.run(fn p -> graph(p, params, tell) end)
    events = drain(tag)
    expect = case["expect"]
    inputs = events |> Enum.flat_map(&unsubscribed/1) |> Enum.sort()
    position = fn name -> Enum.find_index(report.closed, &(last(&1) == name)) end

    wrong =
      Enum.reject(expect["must_close_before"], fn [a, b] -> position.(a) < position.(b) end) ++
        if(expect["all_emitters_close"] and length(report.closed) != components(params),
          do: [{:closed, report.closed}],
          else: []
        ) ++
        if(Enum.sort(expect["inputs_unsubscribed"]) != inputs -- never(expect, inputs),
          do: [{:inputs, inputs}],
          else: []
        ) ++
        for(
          {key, n} <- received(expect),
          not fits?(n, count(events, key)),
          do: {key, count(events, key)}
        )

    if wrong == [], do: :pass, else: {:fail, expect, {report.closed, wrong}}
  end

  def check(%{"op" => "subpipeline", "params" => %{"timer_ms" => interval}} = case) do
    {tell, tag} = teller()

    {:ok, pid} =
      Pipeline.start(
        fn p ->
          p
          |> Pipeline.composite("Sub", &Situ.source(&1, Ticker, interval: ms(interval)))
          |> Situ.each(tell)
        end,
        []
      )

    completed? = match?({:ok, _}, Pipeline.await(pid, case["params"]["observe_ms"]))
    stopped = Pipeline.stop(pid)
    values = drain(tag)

    verdict(case["expect"], %{
      "completed_after_#{case["params"]["observe_ms"]}_ms" => completed?,
      "completed_after_dispose" => match?({:ok, _}, stopped),
      "first_values" => Enum.take(values, length(case["expect"]["first_values"]))
    })
  end

  # A source inside, or with a function a source outside and the function inside.
  def check(%{"op" => "subpipeline", "inputs" => [%{"messages" => messages}]} = case) do
    {tell, tag} = teller()
    source = &Situ.source(&1, Source, kind: {:messages, timed(messages)})
    function = case["params"]["function"]

    {:ok, _} =
      Pipeline.run(
        fn p ->
          if function do
            fun = Formula.of_one(function)
            p |> source.() |> Situ.composite("Sub", &Situ.map(&1, fun)) |> Situ.each(tell)
          else
            p |> Pipeline.composite("Sub", source) |> Situ.each(tell)
          end
        end,
        pipeline: [replay: [interval: {0, :unbounded}]]
      )

    verdict(values(case["expect"]), drain(tag))
  end

  def check(%{"op" => "connector", "inputs" => [%{"messages" => messages}]} = case) do
    {tell, tag} = teller()
    script = timed(messages)
    connector = Situ.Connector.new("Between")

    {:ok, target} =
      Pipeline.start(fn p -> p |> Situ.Connector.receive(connector) |> Situ.each(tell) end, [])

    :ok = Situ.Connector.await_open(connector, 5_000)

    {:ok, _} =
      Pipeline.run(
        fn p ->
          p |> Situ.source(Source, kind: {:messages, script}) |> Situ.Connector.send(connector)
        end,
        pipeline: [replay: [interval: {0, :unbounded}]]
      )

    first =
      receive do
        {^tag, value} -> value
      after
        100 -> :nothing
      end

    Pipeline.stop(target)
    if first == elem(hd(script), 1), do: :pass, else: {:fail, case["expect"], first}
  end

  # The pipeline of the stop-from-handler case: a component that, when its input closes, asks for the stop.
  defp stopping(tell, messages) do
    fn p ->
      stream = Situ.source(p, Source, kind: {:messages, messages})

      Situ.composite(stream, "Sub", fn stream ->
        stream = Situ.each(stream, tell, async: true)
        node = Pipeline.add(stream.pipeline, Relay, tell: tell, at_close: true)
        Pipeline.connect(stream, node, :x)
      end)
    end
  end

  # Sources by description.

  defp source(p, "subpipeline(" <> rest) do
    inner = rest |> String.trim_trailing(")") |> String.split([",", "+"], trim: true)

    Pipeline.composite(p, unique("Sub"), fn sub ->
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

  # Graphs of the finalisation cases.

  defp graph(p, params, tell) do
    edges = Enum.flat_map(params["edges"], &edges/1)
    generators = for {a, "gen", _, _} <- edges, do: a
    subs = Map.get(params, "subpipelines", %{})

    nodes =
      for name <- params["construction_order"],
          not Map.has_key?(subs, name),
          not (name =~ ~r/^c[A-Z]/),
          into: %{} do
        module = if name in generators, do: Generator, else: Relay
        sub = Enum.find_value(subs, fn {sub, members} -> name in members && sub end)

        {name,
         Pipeline.add(scope(p, sub), module, [tell: tell, gen: name in generators], name: name)}
      end

    for {a, output, b, input} <- edges do
      stream = Situ.Node.output(nodes[a], String.to_existing_atom(output))
      Pipeline.connect(stream, nodes[b], String.to_existing_atom(input))
    end
  end

  defp scope(p, nil), do: p
  defp scope(p, sub), do: %{p | scope: sub}

  # Connectors between a pipeline and its part are no components here: an edge through one is an edge.
  defp edges(text) do
    [first | rest] = text |> String.split("->") |> Enum.filter(&String.contains?(&1, "."))

    [first | rest]
    |> Enum.chunk_every(2, 1, :discard)
    |> Enum.map(fn [from, to] ->
      [a, output] = String.split(from, ".")
      [b, input] = String.split(to, ".")
      {a, output, b, input}
    end)
  end

  defp components(params) do
    subs = Map.keys(Map.get(params, "subpipelines", %{}))
    Enum.count(params["construction_order"], &(&1 not in subs and not (&1 =~ ~r/^c[A-Z]/)))
  end

  defp unsubscribed({:closed, path, input}), do: ["#{last(path)}.#{input}"]
  defp unsubscribed(_), do: []

  # Cases list the inputs they are about; others may close besides, but for those said to stay.
  defp never(expect, inputs) do
    (inputs -- expect["inputs_unsubscribed"]) -- (expect["unconnected_inputs_unsubscribed"] || [])
  end

  defp received(expect) do
    for {key, n} <- expect,
        [_, name, input] <- [Regex.run(~r/^(\w+)_received_on_(\w+)$/, key)],
        do: {{name, input}, n}
  end

  defp count(events, {name, input}) do
    Enum.count(events, fn
      {:received, path, on} -> last(path) == name and to_string(on) == input
      _ -> false
    end)
  end

  defp fits?(">= " <> n, got), do: got >= String.to_integer(n)
  defp fits?(n, got), do: n == got

  defp last(path), do: path |> String.split(".") |> List.last()

  defp errors({:ok, report}), do: length(report.errors)
  defp errors({:error, error}), do: length(error.meta.errors)

  defp values([%{"v" => _} | _] = messages), do: Enum.map(messages, & &1["v"])
  defp values(values), do: values

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

  defp teller do
    me = self()
    tag = make_ref()
    {fn event -> send(me, {tag, event}) end, tag}
  end

  defp drain(tag) do
    receive do
      {^tag, event} -> [event | drain(tag)]
    after
      0 -> []
    end
  end
end
