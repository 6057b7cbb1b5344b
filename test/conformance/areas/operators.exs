Code.require_file("operators/clocked.exs", __DIR__)

defmodule Situ.Conformance.Operators do
  import Situ.Conformance.Case
  alias Situ.Conformance.{Facts, Formula, Run}
  alias Situ.Conformance.Operators.Clocked

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
    all(case, Facts.of(case["expect"], outputs))
  end

  def check(%{"op" => op} = case) when op in ["delay", "event_source"], do: Clocked.check(case)

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
  def build("delay", stream, params), do: Situ.delay(stream, Clocked.delay(params))

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
