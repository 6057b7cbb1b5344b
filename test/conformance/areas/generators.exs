defmodule Situ.Conformance.Generators do
  import Situ.Conformance.Case
  alias Situ.Conformance.{Formula, Run}

  # Ticks from year 1 to the Unix epoch. The alignments of the reference count from year 1.
  @epoch_ticks 621_355_968_000_000_000
  @max_ticks 3_155_378_975_999_999_999

  def operation?(op),
    do:
      Enum.all?(parts(op), fn {kind, _} -> kind in ~w(sequence range repeat return once timer) end)

  # Advances the clock by this time. Returns whether the pipeline has ended, and its messages so
  # far.
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
        each = fn fits? -> Enum.all?(outputs, fn {time, _} -> fits?.(time) end) end

        got = %{
          "count" => length(outputs),
          "each" =>
            told(case["expect"]["each"], [
              {~r/.*multiple of (\d+) ?(ms|ticks|us|s)/,
               fn [n, unit] -> each.(&(Integer.mod(&1 - origin(align), unit(n, unit)) == 0)) end},
              {~r/originating_ticks mod (\d+) = (\d+)/,
               fn [n, rest] ->
                 each.(
                   &(Integer.mod(div(&1, 100) + @epoch_ticks, String.to_integer(n)) ==
                       String.to_integer(rest))
                 )
               end},
              {~r/.*(?:congruent|aligned|equal) to .*(?:modulo|mod) .*/,
               fn _ -> each.(&(Integer.mod(&1 - align, interval) == 0)) end}
            ])
        }

        with :pass <- all(case, got),
             do: verdict(params["count"] || length(outputs), length(outputs))

      error ->
        outputs(case, error)
    end
  end

  def check(%{"op" => op, "params" => params} = case) do
    result = run(fn p -> op |> parts() |> Enum.map(&generator(&1, p, params)) |> hd() end, params)
    outputs(case, result)
  end

  # "repeat keep_open + once": generators and their properties.
  defp parts(op) do
    for part <- String.split(op, "+") do
      [kind | flags] = String.split(part)
      [kind | more] = String.split(kind, ".")
      flags = flags ++ more
      open = if "keep_open" in flags, do: [keep_open: true], else: []
      {kind, if("infinite" in flags, do: [count: :infinity], else: []) ++ open}
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

  defp observed(case, _params, running?, outputs) do
    first =
      for {"first_" <> n = key, text} <- case["expect"],
          into: %{},
          do: {key, first(text, Enum.take(outputs, String.to_integer(n)))}

    values = Enum.map(outputs, &elem(&1, 1))

    got = %{
      "stopped" => not running?,
      "completed" => not running?,
      "count" => length(outputs),
      "outputs" => length(outputs),
      "values" => values,
      "received" => values
    }

    all(case, Map.merge(got, first))
  end

  # The first messages, as text or as a list: "t_ms = v = 0..399", "value 123 at t_ms 0..399".
  defp first([%{} | _] = messages, outputs),
    do: if(timed(messages) == outputs, do: messages, else: outputs)

  defp first(list, outputs) when is_list(list), do: Enum.map(outputs, &elem(&1, 1))

  defp first(text, outputs) do
    number = fn value -> with {n, ""} <- Integer.parse(value), do: n, else: (_ -> value) end

    told(text, [
      {~r/t_(ms|ticks|us|s) = v = (\d+)\.\.(\d+)/,
       fn [unit, from, to] -> outputs == row(unit, from, to, & &1) end},
      {~r/(\S+) at (\d+)\.\.(\d+) (ms|ticks|us|s)/,
       fn [value, from, to, unit] ->
         outputs == row(unit, from, to, fn _ -> number.(value) end)
       end},
      {~r/value (\S+) at t_(ms|ticks|us|s) (\d+)\.\.(\d+)/,
       fn [value, unit, from, to] ->
         outputs == row(unit, from, to, fn _ -> number.(value) end)
       end}
    ])
  end

  defp row(unit, from, to, value) do
    for n <- String.to_integer(from)..String.to_integer(to)//1, do: {unit(n, unit), value.(n)}
  end

  defp unit(n, unit) when is_binary(n), do: n |> String.to_integer() |> unit(unit)
  defp unit(n, "ms"), do: ms(n)
  defp unit(n, "ticks"), do: ticks(n)
  defp unit(n, "us"), do: n * 1_000
  defp unit(n, "s"), do: ms(n * 1_000)

  # "A multiple of 10 ms" counts from year 1 in the reference, like alignments.
  defp origin(_align), do: ticks(-@epoch_ticks)

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
    {count, flags} = Keyword.pop(flags, :count, Map.get(params, "count", 10))
    flags = params |> Map.delete("count") |> options(flags)
    start = params["start"] || 0
    range(p, start, if(count == nil, do: :infinity, else: count), params, flags)
  end

  # Clock ticks, counted from the start.
  defp generator({"timer", _flags}, p, params), do: Situ.timer(p, every: interval(params))

  defp generator({"repeat", flags}, p, params),
    do:
      Situ.repeat(
        p,
        Map.get(params, "value", 1),
        [every: interval(params)] ++ options(params, flags)
      )

  defp generator({"return", _flags}, p, params), do: Situ.return(p, Map.get(params, "value", 1))

  defp generator({"once", _flags}, p, params),
    do: Situ.return(p, Map.get(params, "value", 1), keep_open: true)

  defp range(p, start, :infinity, params, flags),
    do: Situ.sequence(p, start, &(&1 + 1), [every: interval(params)] ++ flags)

  defp range(p, start, count, params, flags) do
    Situ.from_enumerable(p, start..(start + count - 1)//1, [every: interval(params)] ++ flags)
  end

  # Values with a fixed interval, or with their own times.
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
