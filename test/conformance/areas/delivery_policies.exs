defmodule Situ.Conformance.DeliveryPolicies do
  # Tests one queue directly, and policies in pipelines.
  import Situ.Conformance.Case, only: [all: 2, told: 2, verdict: 2, ms: 1, timed: 1]
  alias Situ.{Delivery, Message, Pipeline}
  alias Situ.Conformance.Formula
  alias Situ.Delivery.Queue

  defmodule Script do
    # A pull source of `{time, value}` pairs, one at a time. It reports the process in which it
    # runs.
    use Situ.Component,
      outputs: [out: :any],
      options: [
        messages: [type: :list, required: true],
        report: [type: {:fun, 1}, required: true]
      ]

    @impl true
    def init(opts), do: {:ok, {opts[:messages], opts[:report]}}

    @impl true
    def handle_demand(_n, _context, {[{time, value}], report}) do
      report.({:source, self()})
      {[{:out, time, value}, {:complete, time}], {[], report}}
    end

    def handle_demand(_n, _context, {[], report}), do: {[], {[], report}}

    def handle_demand(_n, _context, {[{time, value} | rest], report}),
      do: {[{:out, time, value}], {rest, report}}
  end

  def operation?(op), do: op in ~w(delivery_queue delivery delivery.store_write)

  def check(%{"op" => "delivery_queue", "params" => params} = case) do
    policy = policy(params["policy"])
    start = {Queue.new(policy), []}

    {steps, {_queue, dropped}} =
      Enum.map_reduce(case["expect"]["steps"], start, &step(&1, &2, policy))

    all(case, %{"steps" => steps, "dropped" => Enum.map(dropped, & &1.data)})
  end

  # A chain of stages, one per policy.
  def check(%{"op" => "delivery", "params" => %{"policies" => names} = params} = case) do
    stages = for {name, i} <- Enum.with_index(names, 1), do: {"stage#{i}", policy(name)}

    got =
      run(case, [speed: :max], fn stream, tell ->
        Enum.reduce(stages, stream, fn {stage, policy}, stream ->
          takes = params[stage <> "_takes_ms"] || 0
          Situ.each(stream, &(tell.({stage, &1, self()}) && pause(takes)), policy: policy)
        end)
      end)

    values = Map.new(stages, fn {stage, _} -> {stage, for({^stage, v, _} <- got, do: v)} end)
    contexts = got |> Enum.map(&context/1) |> Enum.uniq()

    execution =
      told(case["expect"]["execution"] || "", [
        {~r/.*in the same (?:execution )?(?:context|thread|process)/, length(contexts) == 1}
      ])

    all(case, Map.merge(values, %{"execution" => execution, "dropped" => lost(case, values)}))
  end

  def check(%{"op" => "delivery", "params" => params} = case) do
    policy = params["policy"] |> policy() |> guarantee(params["guarantee"])
    takes = params["receiver_takes_ms"] || 0
    observe = params["observe_ms"]

    got =
      run(case, [speed: 1.0, observe: observe], fn stream, tell ->
        Situ.each(stream, fn v -> tell.({:got, v, self()}) && pause(takes) end, policy: policy)
      end)

    received = for {:got, v, _} <- got, do: v
    includes = case["expect"]["received_includes"]
    includes = if is_list(includes) and includes -- received == [], do: includes, else: received

    all(case, %{
      "received" => received,
      "received_includes" => includes,
      "count" => length(received),
      "last" => List.last(received),
      "unique" => Enum.uniq(received) == received,
      "increasing" => Enum.sort(received) == received
    })
  end

  def check(%{"op" => "delivery.store_write", "params" => params} = case) do
    if Code.ensure_loaded?(Situ.Store),
      do: stored(case, params),
      else: {:not_applicable, "the store is not part of this build"}
  end

  # A pause of 0 ms must not yield the processor, as a sleep would.
  defp pause(0), do: :ok
  defp pause(ms), do: Process.sleep(ms)

  # The actions of a step come from the case; everything else must be an effect of them.
  defp step(step, {queue, dropped}, policy) do
    {gives, queue, lost} = act(step, queue)

    came = %{
      "gives" => gives,
      "queue_after" => waiting(queue),
      "queue_length" => length(Queue.to_list(queue)),
      "dropped" => Enum.map(lost, &shown/1),
      "source_throttled" => throttled?(policy, queue),
      "throttled" => throttled?(policy, queue)
    }

    {Map.merge(Map.take(step, ~w(do v t_ms now_ms)), Map.take(came, Map.keys(step))),
     {queue, dropped ++ lost}}
  end

  defp act(%{"do" => "enqueue"} = step, queue) do
    {queue, lost} =
      Queue.push(queue, %Message{data: step["v"], originating_time: ms(step["t_ms"])})

    {nil, queue, lost}
  end

  defp act(%{"do" => "enqueue_closing"} = step, queue) do
    {queue, lost} = Queue.push(queue, {:closed, ms(step["t_ms"])})
    {nil, queue, lost}
  end

  defp act(%{"do" => "dequeue"} = step, queue) do
    {entry, queue, lost} = Queue.pop(queue, ms(step["now_ms"]))
    {if(entry, do: shown(entry)), queue, lost}
  end

  # A producer waits while a full window of messages waits to be consumed.
  defp throttled?(%{kind: :throttle, window: window}, queue),
    do: length(Queue.to_list(queue)) >= window

  defp throttled?(_policy, _queue), do: false

  defp lost(case, values) do
    [%{"messages" => messages}] = case["inputs"]
    last = values |> Enum.sort() |> List.last() |> elem(1)
    for({_, v} <- timed(messages), do: v) -- last
  end

  defp waiting(queue), do: queue |> Queue.to_list() |> Enum.map(&shown/1)
  defp shown({:closed, _}), do: "<closing>"
  defp shown(message), do: message.data

  # "latest", "synchronous_or_throttle", "queue_size(3)", "latency_constrained(10 ms)",
  # "queue_size_throttled(4)".
  defp policy(nil), do: Delivery.unlimited()

  defp policy(text) when is_binary(text) do
    {name, n} =
      case Regex.run(~r/^(\w+)\s*\(\s*(\d+)\s*(?:ms)?\s*\)$/, text) do
        [_, name, n] -> {name, String.to_integer(n)}
        nil -> {text, nil}
      end

    cond do
      name =~ "unlimited" -> Delivery.unlimited()
      name =~ "synchronous" -> Delivery.synchronous()
      name =~ "throttle" and n != nil -> Delivery.throttle(n)
      name =~ "throttle" -> Delivery.throttle()
      name =~ "latest" -> Delivery.latest()
      name =~ "latency" -> Delivery.max_latency(ms(n))
      name =~ "queue" -> Delivery.max_queue(n)
    end
  end

  defp policy(%{} = params) do
    throttle = Enum.find_value(params, fn {key, n} -> key =~ "throttl" and is_integer(n) && n end)

    base =
      case params do
        _ when throttle != nil -> Delivery.throttle(throttle)
        %{"max_queue" => n, "throttle_when_full" => true} -> Delivery.throttle(n)
        %{"max_queue" => n} when is_integer(n) -> Delivery.max_queue(n)
        %{"max_latency_ms" => d} -> Delivery.max_latency(ms(d))
        _ -> Delivery.unlimited()
      end

    base =
      if params["max_queue"] && params["max_latency_ms"],
        do: %{base | max_latency: ms(params["max_latency_ms"])},
        else: base

    guarantee(base, params["guarantee"])
  end

  defp guarantee(policy, nil), do: policy

  defp guarantee(policy, text) do
    text
    |> String.split(", then chained: ")
    |> Enum.reduce(policy, fn rule, policy ->
      Delivery.with_guarantee(policy, Formula.condition(rule))
    end)
  end

  defp run(%{"inputs" => [%{"messages" => messages}]}, opts, build) do
    me = self()
    tag = make_ref()
    tell = fn event -> send(me, {tag, event}) end
    script = timed(messages)
    settings = [replay: [interval: {0, :unbounded}, speed: opts[:speed]]]

    {:ok, pipeline} =
      Pipeline.start(
        fn p -> p |> Situ.source(Script, messages: script, report: tell) |> build.(tell) end,
        pipeline: settings
      )

    if opts[:observe], do: Process.sleep(opts[:observe])

    if opts[:observe],
      do: Pipeline.stop(pipeline),
      else: {:ok, _} = Pipeline.await(pipeline, 60_000)

    drain(tag)
  end

  defp context({:source, pid}), do: pid
  defp context({_stage, _value, pid}), do: pid

  defp drain(tag) do
    receive do
      {^tag, event} -> [event | drain(tag)]
    after
      0 -> []
    end
  end

  # The store belongs to another application, and this one may be compiled without it.
  defp store, do: Situ.Store

  defp stored(case, params) do
    path = Path.join(System.tmp_dir!(), "situ-conformance-#{System.unique_integer([:positive])}")
    script = for n <- 1..params["count"], do: {n * params["interval_ticks"] * 100, n}

    {:ok, _} =
      Pipeline.run(
        fn p ->
          store = store().create(p, "policies", path)

          p
          |> Situ.source(Script, messages: script, report: fn _ -> :ok end)
          |> store().write(store, "Numbers", write_policy(params))
        end,
        pipeline: [
          default_policy: policy(params["pipeline_default"] || "unlimited"),
          replay: [interval: {0, :unbounded}]
        ]
      )

    me = self()
    tag = make_ref()

    {:ok, _} =
      Pipeline.run(fn p ->
        store = store().importer(p, Path.join(path, "policies"))
        store |> store().stream("Numbers") |> Situ.each(&send(me, {tag, &1}))
      end)

    File.rm_rf!(path)
    stored = length(drain(tag))

    case case["expect"] do
      %{"stored" => "<" <> most} -> below(stored, most)
      %{"stored_less_than" => most} -> below(stored, most)
      expect -> verdict(expect, %{"stored" => stored})
    end
  end

  defp write_policy(%{"write_policy" => name}) when name != nil, do: [policy: policy(name)]
  defp write_policy(_params), do: []

  defp below(stored, most) do
    most = if is_binary(most), do: most |> String.trim() |> String.to_integer(), else: most
    if stored < most, do: :pass, else: {:fail, "fewer than #{most} stored", stored}
  end
end
