defmodule Situ.Conformance.Generators do
  import Situ.Conformance.Case
  alias Situ.Conformance.Run

  # Ticks since year 1 at the Unix epoch: what the alignments of the reference count from.
  @epoch_ticks 621_355_968_000_000_000
  @max_ticks 3_155_378_975_999_999_999

  def check(%{"known_quirk" => true} = case),
    do: case |> Map.delete("known_quirk") |> check() |> quirk()

  def check(%{"op" => op, "params" => %{"observe_ms" => observe} = params} = case) do
    test = Situ.Test.start([], fn _, p -> watched(op, p, params) end)
    Situ.Test.advance(test, ms(observe))
    outputs = Situ.Test.outputs(test)
    running? = Situ.Pipeline.state(test.pipeline) == :running
    Situ.Test.stop(test)
    observed(case, params, running?, outputs)
  end

  def check(%{"op" => "sequence.timestamped", "params" => params} = case) do
    items = timed(params["items"])
    outputs(case, run(fn p -> Situ.from_enumerable(p, items) end, 0))
  end

  def check(%{"op" => op, "params" => params, "expect" => %{"each" => _}} = case) do
    interval = interval(params)
    align = align(params)

    case run(fn p -> generator(op, p, params) end, 0) do
      {:ok, outputs} ->
        off = for {time, _} <- outputs, Integer.mod(time - align, interval) != 0, do: time
        verdict({params["count"], []}, {length(outputs), off})

      error ->
        outputs(case, error)
    end
  end

  def check(%{"op" => op, "params" => params} = case) do
    start = ms(params["replay_start_ms"] || 0)
    outputs(case, run(fn p -> generator(op, p, params) end, start))
  end

  defp run(build, start) do
    Run.guarded(fn ->
      opts = [times: true, pipeline: [replay: [interval: {start, :unbounded}, speed: :max]]]
      {:ok, Situ.to_list(build, opts)}
    end)
  end

  defp watched("repeat keep_open + once", p, _params) do
    [Situ.repeat(p, 1, ms(1), count: 10, keep_open: true), Situ.once(p, 2)]
  end

  defp watched(op, p, params), do: generator(op, p, params)

  defp observed(%{"expect" => %{"stopped" => stopped} = expect}, params, running?, outputs) do
    first = if is_list(outputs) and outputs != [] and is_tuple(hd(outputs)), do: outputs, else: []
    wanted = first_400(expect["first_400"], params)
    verdict({stopped, wanted}, {not running?, Enum.take(first, length(wanted))})
  end

  defp first_400(nil, _params), do: []

  defp first_400(_text, params) do
    value = if Map.has_key?(params, "value"), do: fn _ -> params["value"] end, else: & &1
    for n <- 0..399, do: {n * interval(params), value.(n)}
  end

  defp generator("sequence", p, params) do
    next = Run.arithmetic(params["next"], [:v])
    Situ.sequence(p, params["initial"], &next.([&1]), interval(params), options(params))
  end

  defp generator("range", p, params) do
    Situ.range(p, params["start"] || 0, params["count"], interval(params), options(params, []))
  end

  defp generator("repeat", p, params),
    do: Situ.repeat(p, params["value"], interval(params), options(params))

  defp generator("return", p, params), do: Situ.return(p, params["value"])
  defp generator("once", p, params), do: Situ.once(p, params["value"])

  defp interval(%{"interval_ms" => n}), do: ms(n)
  defp interval(%{"interval_ticks" => n}), do: ticks(n)

  defp options(params),
    do: options(params, if(params["count"], do: [count: params["count"]], else: []))

  defp options(params, opts) do
    opts = if params["keep_open"], do: [keep_open: true] ++ opts, else: opts
    if align(params) == nil, do: opts, else: [align: align(params)] ++ opts
  end

  defp align(%{"align_to_ms" => n}), do: ms(n)
  defp align(%{"align_to" => "year 1" <> _}), do: ticks(-@epoch_ticks)
  defp align(%{"align_to" => "maximum" <> _}), do: ticks(@max_ticks - @epoch_ticks)
  defp align(_params), do: nil
end
