defmodule Situ.Conformance.Emitter do
  # Posting rules: which messages an output accepts, and which connections are allowed.
  import Situ.Conformance.Case, only: [all: 2, error_fits?: 2, verdict: 2, ticks: 1, time: 1]
  alias Situ.{Message, Pipeline}
  alias Situ.Conformance.Formula

  defmodule Script do
    # A source that runs a script.
    use Situ.Component, outputs: [out: :any], options: [actions: [type: :list, required: true]]

    @impl true
    def handle_start(_context, opts), do: {opts[:actions], opts}
  end

  defmodule Stranger do
    # Posts on an output that belongs to another component.
    use Situ.Component, inputs: [in: :any], outputs: [mine: :any]

    @impl true
    def handle_message(:in, message, _context, state),
      do: {[{:out, message.originating_time, message.data}], state}
  end

  @codes %{
    "sequence_id_out_of_order" => :sequence_not_increasing,
    "originating_time_not_strictly_increasing" => :time_not_increasing,
    "creation_time_went_back" => :creation_time_went_back,
    "post_from_other_component" => :unknown_output,
    "post_across_components" => :unknown_output,
    "post_across_async_components" => :unknown_output,
    "post_from_another_component" => :unknown_output,
    "different_pipeline" => :different_pipeline,
    "receiver_already_connected" => :already_connected,
    "pipeline_already_running" => :pipeline_running,
    "out_of_order" => :time_not_increasing,
    "invalid_operation" => :already_connected
  }

  def operation?(op), do: op in ~w(deliver post subscribe)

  def check(%{"op" => "deliver", "inputs" => [%{"messages" => messages}]} = case) do
    actions = Enum.map(messages, &action/1) ++ [{:complete, 1_000_000}]
    {result, delivered} = collect(fn p -> Situ.source(p, Script, actions: actions) end)
    outcome(case, result, %{"delivered" => delivered})
  end

  # "fails when v > 5": the values that an output rejects.
  def check(%{"params" => %{"validator" => rule}, "inputs" => [%{"messages" => messages}]} = case) do
    refused? = Formula.condition(rule)

    {result, delivered} =
      collect(fn p ->
        p
        |> Situ.source(Script, actions: posts(messages) ++ [{:complete, :infinity}])
        |> Situ.each(fn v -> if refused?.(v), do: raise(ArgumentError, rule) end)
      end)

    got = %{"delivered" => delivered, "delivered_before_failure" => delivered}

    case {result, case["expect_error"]} do
      {{:ok, _}, nil} -> all(case, got)
      {{:error, _}, nil} -> {:fail, case["expect"], result}
      {{:ok, _}, name} -> {:fail, {:error, name}, :ok}
      {{:error, error}, name} -> refused_by(error, name, case, got)
    end
  end

  def check(%{"op" => "post", "inputs" => [%{"messages" => messages}]} = case) do
    last = messages |> Enum.map(&time/1) |> Enum.max(fn -> 0 end)
    actions = posts(messages) ++ [{:complete, last}]
    {result, delivered} = collect(fn p -> Situ.source(p, Script, actions: actions) end)
    outcome(case, result, %{"delivered" => delivered})
  end

  # Nothing outside of a component has an output to post on.
  def check(%{"op" => "post", "inputs" => [], "expect_error" => "post_outside" <> _}),
    do:
      {:not_applicable,
       "components post by returning actions: there is no way to post from outside"}

  # Posts on another component's output, which is not allowed.
  def check(%{"op" => "post", "expect_error" => _} = case) do
    {result, _} = collect(fn p -> p |> one() |> Situ.via(Stranger, async: true) end)
    outcome(case, result, nil)
  end

  # Posts on its own output, which is allowed.
  def check(%{"op" => "post"} = case) do
    {result, delivered} = collect(fn p -> p |> one() |> Situ.map(& &1, async: true) end)
    error = with {:ok, _report} <- result, do: nil
    all(case, %{"error" => error, "delivered" => delivered, "posted" => delivered == [1]})
  end

  def check(%{"op" => "subscribe", "expect_error" => "different_pipeline" <> _} = case) do
    {p, q} = {Pipeline.new(), Pipeline.new()}
    stream = one(p)
    node = Pipeline.add(q, Stranger)
    refused(case, [p, q], fn -> Pipeline.connect(stream, node, :in) end)
  end

  def check(%{"op" => "subscribe", "params" => %{"pipeline" => "running"}} = case) do
    p = Pipeline.new()
    node = Pipeline.add(p, Stranger, inputs: [in: {:any, optional: true}])
    # The source is infinite, because the pipeline could otherwise end before the subscription.
    stream = Situ.source(p, Script, actions: [{:out, 1, 1}, {:complete, :infinity}])
    :ok = Pipeline.launch(p)
    refused(case, [p], fn -> Pipeline.connect(stream, node, :in) end)
  end

  def check(%{"op" => "subscribe"} = case) do
    p = Pipeline.new()
    node = Pipeline.add(p, Stranger)
    stream = one(p)
    :ok = Pipeline.connect(stream, node, :in)
    refused(case, [p], fn -> Pipeline.connect(stream, node, :in) end)
  end

  defp posts(messages), do: for(m <- messages, do: {:out, time(m), m["v"]})

  defp refused_by(error, name, case, got) do
    cond do
      not error_fits?(name, error) -> {:fail, {:error, name}, error}
      case["expect"] == nil -> :pass
      true -> all(case, got)
    end
  end

  defp one(p), do: Situ.source(p, Script, actions: [{:out, 1, 1}, {:complete, 1}])

  defp refused(case, pipelines, fun) do
    fun.()
    {:fail, {:error, case["expect_error"]}, :ok}
  rescue
    error in Situ.Error -> outcome(case, {:error, error}, nil)
  after
    Enum.each(pipelines, &Pipeline.stop/1)
  end

  defp outcome(%{"expect_error" => name} = case, {:error, %{code: code}}, got) do
    wanted = Map.take(case["expect"] || %{}, Map.keys(got || %{}))
    verdict({Map.get(@codes, name, name), wanted}, {code, Map.take(got || %{}, Map.keys(wanted))})
  end

  defp outcome(%{"expect_error" => name}, other, _got), do: {:fail, {:error, name}, other}
  defp outcome(%{"expect" => expect}, {:ok, _}, got), do: verdict(expect, got)
  defp outcome(%{"expect" => expect}, error, _got), do: {:fail, expect, error}

  defp action(%{"close_at_ticks" => t}), do: {:close, :out, ticks(t)}

  defp action(m) do
    time = ticks(m["originating_ticks"])

    {:out,
     %Message{
       data: m["v"],
       originating_time: time,
       creation_time: ticks(m["creation_ticks"] || m["originating_ticks"]),
       sequence_id: m["sequence_id"]
     }}
  end

  # Runs a graph without log output. Returns the result and the messages of its last stream.
  defp collect(build) do
    me = self()
    tag = make_ref()
    level = Logger.level()
    Logger.configure(level: :none)

    result =
      Pipeline.run(fn p -> p |> build.() |> Situ.each(&send(me, {tag, &1})) end,
        pipeline: [replay: [interval: {-1_000_000, :unbounded}]]
      )

    Logger.configure(level: level)
    {result, drain(tag)}
  end

  defp drain(tag) do
    receive do
      {^tag, value} -> [value | drain(tag)]
    after
      0 -> []
    end
  end
end
