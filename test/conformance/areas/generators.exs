defmodule Situ.Conformance.Generators do
  import Situ.Conformance.Case
  alias Situ.Conformance.{Formula, Run}

  # Ticks since year 1 at the Unix epoch: what the alignments of the reference count from.
  @epoch_ticks 621_355_968_000_000_000
  @max_ticks 3_155_378_975_999_999_999

  def operation?(op),
    do: Enum.all?(parts(op), fn {kind, _} -> kind in ~w(sequence range repeat return once) end)

  # Some time of the clock: is the pipeline over, and what came first.
  def check(%{"op" => op, "params" => %{"observe_ms" => observe} = params} = case) do
    test =
      Situ.Test.start([], fn _, p -> for part <- parts(op), do: generator(part, p, params) end)

    Situ.Test.advance(test, ms(observe))
    [outputs | _] = Situ.Test.outputs(test)
    running? = Situ.Pipeline.state(test.pipeline) == :running
    Situ.Test.stop(test)
    observed(case, params, running?, outputs)
  end

  def check(%{"op" => "sequence." <> _, "params" => %{"items" => _} = params} = case),
    do: outputs(case, run(fn p -> items(p, params) end, params))

  def check(%{"op" => op, "params" => params, "expect" => %{"each" => _}} = case) do
    interval = interval(params)
    align = align(params)
    [part] = parts(op)

    case run(fn p -> generator(part, p, params) end, params) do
      {:ok, outputs} ->
        off = for {time, _} <- outputs, Integer.mod(time - align, interval) != 0, do: time
        verdict({params["count"], []}, {length(outputs), off})

      error ->
        outputs(case, error)
    end
  end

  def check(%{"op" => op, "params" => params} = case) do
    result = run(fn p -> op |> parts() |> Enum.map(&generator(&1, p, params)) |> hd() end, params)
    outputs(case, result)
  end

  # "repeat keep_open + once": generators and what is said of each.
  defp parts(op) do
    for part <- String.split(op, "+") do
      [kind | flags] = String.split(part)
      {hd(String.split(kind, ".")), if("keep_open" in flags, do: [keep_open: true], else: [])}
    end
  end

  defp run(build, params) do
    start = replay(params, "start") || 0
    stop = replay(params, "end") || :unbounded

    Run.guarded(fn ->
      opts = [times: true, pipeline: [replay: [interval: {start, stop}, speed: :max]]]
      {:ok, Situ.to_list(build, opts)}
    end)
  end

  defp replay(params, side) do
    ticks = params["replay_#{side}_ticks"]
    if n = params["replay_#{side}_ms"], do: ms(n), else: ticks && ticks(ticks)
  end

  defp observed(%{"expect" => %{"stopped" => stopped} = expect}, params, running?, outputs) do
    wanted = first(expect, params)
    verdict({stopped, wanted}, {not running?, Enum.take(outputs, length(wanted))})
  end

  # "first_400": so many messages an interval apart, of a repeated value or of their numbers.
  defp first(expect, params) do
    counts = for {"first_" <> n, _} <- expect, {n, ""} <- [Integer.parse(n)], do: n
    value = if Map.has_key?(params, "value"), do: fn _ -> params["value"] end, else: & &1
    for n <- 0..(Enum.max([0 | counts]) - 1)//1, do: {n * interval(params), value.(n)}
  end

  defp generator({"sequence", _flags}, p, %{"items" => _} = params), do: items(p, params)

  defp generator({"sequence", flags}, p, params) do
    next = Formula.of_one(params["next"])

    Situ.sequence(
      p,
      params["initial"] || 0,
      next,
      [every: interval(params)] ++ options(params, flags)
    )
  end

  defp generator({"range", flags}, p, params) do
    flags = params |> Map.delete("count") |> options(flags)

    {start, count} = {params["start"] || 0, params["count"] || 10}
    Situ.from_enumerable(p, start..(start + count - 1)//1, [every: interval(params)] ++ flags)
  end

  defp generator({"repeat", flags}, p, params),
    do:
      Situ.repeat(
        p,
        Map.get(params, "value", 1),
        [every: interval(params)] ++ options(params, flags)
      )

  defp generator({"return", _flags}, p, params), do: Situ.return(p, Map.get(params, "value", 1))
  defp generator({"once", _flags}, p, params), do: Situ.once(p, Map.get(params, "value", 1))

  # Values an interval apart, or with times of their own.
  defp items(p, params) do
    opts = params |> Map.delete("count") |> options([])

    case params["items"] do
      [%{} | _] = items -> Situ.from_enumerable(p, timed(items), started(params) ++ opts)
      [] -> Situ.from_enumerable(p, [], opts)
      items -> Situ.from_enumerable(p, value(items), [every: interval(params)] ++ opts)
    end
  end

  defp started(%{"start_time_ms" => n}), do: [start: ms(n)]
  defp started(%{"start_time_ticks" => n}), do: [start: ticks(n)]
  defp started(_params), do: []

  defp interval(%{"interval_ms" => n}), do: ms(n)
  defp interval(%{"interval_ticks" => n}), do: ticks(n)
  defp interval(_params), do: ms(1)

  defp options(params, flags) do
    count = if params["count"] == nil, do: [], else: [count: params["count"]]
    keep_open = if params["keep_open"], do: [keep_open: true], else: []
    align = if align(params) == nil, do: [], else: [align: align(params)]
    Keyword.merge(count ++ keep_open ++ align, flags)
  end

  defp align(%{"align_to_ms" => n}), do: ms(n)
  defp align(%{"align_to_ticks" => n}), do: ticks(n)
  defp align(%{"align_to" => "year 1" <> _}), do: ticks(-@epoch_ticks)
  defp align(%{"align_to" => "maximum" <> _}), do: ticks(@max_ticks - @epoch_ticks)
  defp align(_params), do: nil
end
