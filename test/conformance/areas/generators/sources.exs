defmodule Situ.Conformance.Generators.Sources do
  # Builds the generators of a case.
  import Situ.Conformance.Case
  alias Situ.Conformance.{Formula, Text}

  # Ticks from year 1 to the Unix epoch. The alignments of the reference count from year 1.
  @epoch_ticks 621_355_968_000_000_000
  @max_ticks 3_155_378_975_999_999_999

  # "repeat keep_open + once": generators and their properties.
  def parts(op) do
    for part <- String.split(op, "+") do
      [kind | flags] = String.split(part)
      [kind | more] = String.split(kind, ".")
      flags = flags ++ more
      open = if "keep_open" in flags, do: [keep_open: true], else: []
      {kind, if("infinite" in flags, do: [count: :infinity], else: []) ++ open}
    end
  end

  def generator({"sequence", _flags}, p, %{"items" => _} = params), do: items(p, params)

  def generator({"sequence", flags}, p, params) do
    next = Formula.of_one(params["next"])

    Situ.sequence(
      p,
      params["initial"] || 0,
      next,
      [every: interval(params)] ++ options(params, flags)
    )
  end

  def generator({"range", flags}, p, params) do
    {count, flags} = Keyword.pop(flags, :count, Map.get(params, "count", 10))
    flags = params |> Map.delete("count") |> options(flags)
    start = params["start"] || 0
    range(p, start, if(count == nil, do: :infinity, else: count), params, flags)
  end

  # Clock ticks, counted from the start.
  def generator({"timer", _flags}, p, params), do: Situ.timer(p, every: interval(params))

  def generator({"repeat", flags}, p, params),
    do:
      Situ.repeat(
        p,
        Map.get(params, "value", 1),
        [every: interval(params)] ++ options(params, flags)
      )

  def generator({"return", _flags}, p, params), do: Situ.return(p, Map.get(params, "value", 1))

  def generator({"once", _flags}, p, params),
    do: Situ.return(p, Map.get(params, "value", 1), keep_open: true)

  defp range(p, start, :infinity, params, flags),
    do: Situ.sequence(p, start, &(&1 + 1), [every: interval(params)] ++ flags)

  defp range(p, start, count, params, flags) do
    Situ.from_enumerable(p, start..(start + count - 1)//1, [every: interval(params)] ++ flags)
  end

  # Values with a fixed interval, or with their own times.
  def items(p, params) do
    opts = params |> Map.delete("count") |> options([])

    case params["items"] do
      [%{} | _] = items -> Situ.from_enumerable(p, timed(items), started(params) ++ opts)
      [] -> Situ.from_enumerable(p, [], opts)
      items -> Situ.from_enumerable(p, value(items), [every: interval(params)] ++ opts)
    end
  end

  defp started(params),
    do: if(start = duration(params, "start_time"), do: [start: start], else: [])

  def interval(params), do: duration(params, "interval") || ms(1)

  defp options(params, flags) do
    count = if params["count"] == nil, do: [], else: [count: params["count"]]
    keep_open = if params["keep_open"], do: [keep_open: true], else: []
    align = if align(params) == nil, do: [], else: [align: align(params)]
    Keyword.merge(count ++ keep_open ++ align, flags)
  end

  def align(%{"align_to" => "year 1" <> _}), do: ticks(-@epoch_ticks)
  def align(%{"align_to" => "min" <> _}), do: ticks(-@epoch_ticks)
  def align(%{"align_to" => "max" <> _}), do: ticks(@max_ticks - @epoch_ticks)
  def align(%{"align_to" => text}) when is_binary(text), do: Text.duration!(text)
  def align(params), do: duration(params, "align_to")
end
