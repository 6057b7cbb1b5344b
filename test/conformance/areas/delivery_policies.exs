for file <- ~w(policies queues),
    do: Code.require_file("delivery_policies/#{file}.exs", __DIR__)

defmodule Situ.Conformance.DeliveryPolicies do
  # Policies in pipelines. One queue is tested by itself (delivery_policies/queues.exs).
  import Situ.Conformance.Case, only: [all: 2, told: 2, verdict: 2, timed: 1]
  import Situ.Conformance.DeliveryPolicies.Policies
  alias Situ.Conformance.DeliveryPolicies.Queues
  alias Situ.Pipeline
  alias Situ.Conformance.{Facts, Text}

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

  # A fact that compares two stages, and the relation of a stage to another one.
  @words "equals?|same_as|more_than|greater_than|fewer_than|less_than|subset_of"
  @comparison ~r/^(.+?)(_(?:is_)?(?:#{@words})_| ?(?:==|=|>|<) ?)(.+)$/
  @context "(?:execution )?(?:context|thread|process)"
  @first "(?:the )?(?:first|stage ?1)(?: receiver)?"
  @relations "(?:not )?(?:same|equals?|identical)(?: as| to)?|(?:a )?(?:proper )?subset of"
  @relation ~r/^(?:the )?(#{@relations}) (stage ?\d|(?:the )?input|posted)(?: \([^()]*\))?$/

  def operation?(op), do: op in ~w(delivery_queue delivery delivery.store_write)

  def check(%{"op" => "delivery_queue"} = case), do: Queues.check(case)

  # A chain of stages, one per policy, behind the given messages or a timer.
  def check(%{"op" => "delivery", "params" => params, "expect" => expect} = case) do
    stages = stages(params)
    got = run(case, stages)
    last = stages |> List.last() |> elem(0)

    received =
      for {stage, _, _} <- stages, into: %{}, do: {stage, for({^stage, v, _} <- got, do: v)}

    values = Map.merge(received, %{"received" => received[last], "input" => posted(case, got)})
    all(case, answers(expect, values, got))
  end

  def check(%{"op" => "delivery.store_write", "params" => params} = case) do
    if Code.ensure_loaded?(Situ.Store),
      do: stored(case, params),
      else: {:not_applicable, "the store is not part of this build"}
  end

  # Each stage has a name, a policy, and a time that its receiver takes.
  defp stages(%{"policies" => policies} = params) do
    for {text, i} <- Enum.with_index(policies, 1),
        do: {"stage#{i}", policy(text), params["stage#{i}_takes_ms"] || 0}
  end

  defp stages(params) do
    policy = params["policy"] |> policy() |> guarantee(params["guarantee"])
    [{"stage1", policy, params["receiver_takes_ms"] || 0}]
  end

  # Facts about the stages are derived from what each of them received, in any of these forms:
  # "stage2": [1, 2], "stage2": "same as stage1", "stage1_count": "< 10", "stage1_equals_stage2": true,
  # "posted > stage1": true. Facts without a name are about the last stage.
  defp answers(expect, values, got) do
    last = for v <- values["received"], do: {0, v}

    known =
      for {key, wanted} <- expect,
          answer = answer(key, wanted, values, got),
          into: %{},
          do: {key, elem(answer, 0)}

    Facts.of(expect, last, known)
  end

  defp answer("execution", text, _values, got), do: {execution(text, got)}

  defp answer("dropped", wanted, values, _got) when is_list(wanted),
    do: {values["input"] -- values["received"]}

  defp answer("dropped", wanted, values, _got) when is_boolean(wanted),
    do: {values["input"] != values["received"]}

  defp answer("dropped", _count, values, _got),
    do: {length(values["input"]) - length(values["received"])}

  defp answer(key, wanted, values, _got) do
    whole = named(key, values)

    cond do
      whole && is_list(wanted) ->
        {whole}

      whole && related(wanted, whole, values) != nil ->
        {if(related(wanted, whole, values), do: wanted, else: whole)}

      whole ->
        {length(whole)}

      match = Regex.run(~r/^(\w+)_count$/, key) ->
        counted(match, values)

      match = Regex.run(@comparison, key) ->
        compared(match, values)

      true ->
        nil
    end
  end

  defp counted([_, name], values), do: if(list = named(name, values), do: {length(list)})

  defp compared([_, a, how, b], values) do
    with a when a != nil <- named(a, values), b when b != nil <- named(b, values) do
      cond do
        how =~ ~r/more|greater|>/ -> {length(a) > length(b)}
        how =~ ~r/fewer|less|</ -> {length(a) < length(b)}
        how =~ ~r/subset/ -> {a -- b == []}
        true -> {a == b}
      end
    end
  end

  # "stage1", "stage 1", "b" (the second of a, b, c), "posted", "the input".
  defp named(name, values) do
    case name |> String.replace(["the ", " "], "") do
      name when is_map_key(values, name) -> values[name]
      name when name in ~w(posted emitted generated a A) -> values["input"]
      name when name in ~w(b B) -> values["stage1"]
      name when name in ~w(c C) -> values["stage2"]
      _ -> nil
    end
  end

  # "same as stage1", "a proper subset of the input", "not equal to the input (remark)".
  defp related(text, list, values) when is_binary(text) do
    with [_, relation, name] <- Regex.run(@relation, text),
         other when other != nil <- named(name, values) do
      cond do
        relation =~ ~r/proper/ -> list != other and list -- other == []
        relation =~ ~r/subset/ -> list -- other == []
        relation =~ ~r/^not/ -> list != other
        true -> list == other
      end
    else
      _ -> nil
    end
  end

  defp related(_text, _list, _values), do: nil

  # Whether receivers run in the process of the emitter, or the second in the process of the first.
  defp execution(text, got) do
    contexts = fn kind ->
      for event <- got, elem(event, 0) in kind, uniq: true, do: context(event)
    end

    alone? = fn kind -> length(contexts.(kind)) == 1 end

    told(text, [
      {~r/(?:the )?(?:second|stage ?2)(?: receiver)? .*in the same #{@context} as #{@first}/,
       alone?.(["stage1", "stage2"])},
      {~r/.*in the same #{@context}/, alone?.([:source, "stage1", "stage2"])}
    ])
  end

  # A pause of 0 ms must not yield the processor, as a sleep would.
  defp pause(0), do: :ok
  defp pause(ms), do: Process.sleep(ms)

  # What the source has posted: the given messages, or what a timer reported.
  defp posted(%{"inputs" => [%{"messages" => messages}]}, _got),
    do: for({_, v} <- timed(messages), do: v)

  defp posted(_case, got), do: for({:posted, v, _} <- got, do: v)

  # Runs the stages as fast as possible, or for a time. Returns `{stage, value, process}` for each
  # message, and what the source reported.
  defp run(%{"params" => params} = case, stages) do
    me = self()
    tag = make_ref()
    tell = fn event -> send(me, {tag, event}) end
    observe = params["observe_ms"]
    speed = if observe || not is_map_key(params, "policies"), do: 1.0, else: :max

    {:ok, pipeline} =
      Pipeline.start(
        fn p -> p |> source(case, tell) |> chain(stages, tell) end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: speed]]
      )

    if observe, do: Process.sleep(observe)
    if observe, do: Pipeline.stop(pipeline), else: {:ok, _} = Pipeline.await(pipeline, 60_000)
    drain(tag)
  end

  defp source(p, %{"inputs" => [%{"messages" => messages}]}, tell),
    do:
      Situ.source(p, Script,
        messages: timed(messages),
        report: &tell.({:source, nil, elem(&1, 1)})
      )

  defp source(p, %{"params" => params}, tell) do
    interval = Text.duration(params, "timer") || Text.duration(params, "interval")
    interval = interval || Text.unknown!("a source without messages or an interval", params)
    Situ.timer(p, every: interval, fun: fn i, _time -> tell.({:posted, i, self()}) && i end)
  end

  defp chain(stream, stages, tell) do
    Enum.reduce(stages, stream, fn {stage, policy, takes}, stream ->
      Situ.each(stream, &(tell.({stage, &1, self()}) && pause(takes)), policy: policy)
    end)
  end

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
