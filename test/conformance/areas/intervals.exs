defmodule Situ.Conformance.Intervals do
  import Situ.Conformance.Case, only: [all: 2, verdict: 2]
  alias Situ.{Indexer, Interval}
  alias Situ.Conformance.Text

  # The minimum and maximum in the files. Situ's intervals have :unbounded ends, and spans of
  # :infinity.
  @min -0x8000000000000000

  def check(%{"op" => "endpoint", "params" => params} = case) do
    point = bound(params["point"])
    interval = Interval.new(point, params["inclusive"] == true, :unbounded, false)
    got = endpoint(interval.left, interval.left_inclusive, params["unbounded_at"])
    verdict(case["expect"], got)
  end

  def check(%{"op" => "index_range", "params" => %{"start" => start, "end" => stop}} = case) do
    range = {start, stop}

    verdict(case["expect"], %{
      "increasing" => Indexer.increasing_range?(range),
      "single_valued" => Indexer.single_valued?(range),
      "size" => Indexer.range_size(range)
    })
  end

  # The slices of a range apply one after the other. A stride does not change its values.
  def check(%{"op" => "index_definition", "params" => params} = case) do
    range =
      case params do
        %{"size" => size} -> {0, size - 1}
        %{"range" => [first, last]} -> {first, last}
        _ -> Text.unknown!("an index definition", params)
      end

    first = if take = params["take"], do: {:take, take}, else: slice(params["slice"] || "all")
    values = Indexer.range_values(range, first)
    # A slice of taken values is relative to them.
    values = if params["take"], do: sliced(values, slice(params["slice"] || "all")), else: values
    stride = params["stride"] || params["element_stride"] || 1

    expected(case, %{
      "values" => values,
      "ranges" => lists(Indexer.group_runs(values)),
      "count" => length(values),
      "start" => List.first(values),
      "end" => List.last(values),
      "stride" => stride,
      "element_stride" => stride
    })
  end

  def check(%{"op" => "index_" <> _, "params" => params} = case) do
    {shape, window} = shape(params)

    view =
      Enum.reduce(
        [window | slices(params, length(shape))],
        Indexer.new(shape),
        &Indexer.slice(&2, &1)
      )

    indices = Indexer.flat_indices(view)

    expected(case, %{
      "count" => length(indices),
      "values" => indices,
      "ranges" => lists(Indexer.index_ranges(view)),
      "shape" => Indexer.shape(view)
    })
  end

  def check(%{"op" => op, "params" => params} = case), do: expected(case, answer(op, params))

  # Cases list the properties that they test. A list of numbers may be a range: "0..999".
  defp expected(%{"expect" => expect} = case, got) do
    lists =
      for {key, text} when is_binary(text) <- expect,
          is_list(got[key]),
          range = Text.range(text),
          into: %{},
          do: {key, range}

    all(%{case | "expect" => Map.merge(expect, lists)}, got)
  end

  # The shape of the stored array, and the part of it that is indexed. With a stride, rows of the
  # last dimension are stored further apart than they are long.
  defp shape(params) do
    shape = params["shape"] || [params["rows"], params["columns"]]
    stride = params["stride"] || params["row_stride"] || List.last(shape)

    if Enum.all?([stride | shape], &is_integer/1),
      do: {List.replace_at(shape, -1, stride), Enum.map(shape, &{0, &1 - 1})},
      else: Text.unknown!("the shape of an array", params)
  end

  # "slice" with one slice per dimension, then "then_slice"; or a list of such slices.
  defp slices(params, dimensions) do
    first = params["slices"] || params["slice"]
    # A list of slices contains lists with a slice per dimension, which are no ranges.
    several? =
      is_list(first) and (params["slices"] != nil or Enum.all?(first, &nested?(&1, dimensions)))

    first = if several? or first == nil, do: first || [], else: [first]
    then = Enum.reject([params["then_slice"], params["then"]], &is_nil/1)
    for slices <- first ++ then, do: Enum.map(slices, &slice/1)
  end

  defp nested?(list, dimensions),
    do:
      is_list(list) and length(list) == dimensions and
        Enum.any?(list, &(is_list(&1) or &1 == "all"))

  defp sliced(values, slice) do
    for index <- Indexer.range_values({0, length(values) - 1}, slice), do: Enum.at(values, index)
  end

  defp answer("interval", p) do
    properties(
      Interval.new(
        bound(p["left"]),
        p["left_inclusive"] == true,
        bound(p["right"]),
        p["right_inclusive"] == true
      )
    )
  end

  defp answer("interval.left_bounded", p),
    do: properties(Interval.left_bounded(p["left"], Map.get(p, "inclusive", true)))

  defp answer("interval.right_bounded", p),
    do: properties(Interval.right_bounded(p["right"], Map.get(p, "inclusive", true)))

  defp answer("interval.infinite", _), do: properties(Interval.infinite())
  defp answer("interval.empty", _), do: properties(Interval.empty())
  defp answer("interval.span", p), do: properties(closed(p))

  defp answer("interval.center", p), do: %{"center" => extreme(Interval.center_point(closed(p)))}

  defp answer("time_plus_relative", %{"origin" => origin, "relative_minutes" => [left, right]}) do
    closed(%{"left" => left, "right" => right}) |> Interval.translate(origin) |> properties()
  end

  defp answer("interval.contains_point", %{"points" => points} = p) do
    interval = parse(p["interval"])
    Map.new(points, &{to_string(&1), Interval.contains_point?(interval, point(&1))})
  end

  defp answer("interval.contains_point", p),
    do: %{"within" => Interval.contains_point?(parse(p["interval"]), point(p["point"]))}

  defp answer("interval.translate", p),
    do: changed(Interval.translate(parse(p["interval"]), p["by"]))

  defp answer("interval.scale", p) do
    interval = parse(p["interval"])
    left = amount(p["left_factor"], p["left_span"])
    changed(Interval.scale(interval, left, amount(p["right_factor"], p["right_span"])))
  end

  defp answer("interval.scale_" <> side, p) do
    amount = amount(p["factor"], p["span"])
    interval = parse(p["interval"])

    changed(
      case side do
        "left" -> Interval.scale_left(interval, amount)
        "right" -> Interval.scale_right(interval, amount)
        "center" -> Interval.scale_center(interval, amount)
      end
    )
  end

  defp answer("interval.intersects", p) do
    {a, b} = {parse(p["a"]), parse(p["b"])}

    %{
      "intersects" => Interval.intersects?(a, b),
      "disjoint" => Interval.disjoint?(a, b),
      "symmetric" => Interval.intersects?(a, b) == Interval.intersects?(b, a)
    }
  end

  defp answer("interval.subset", p) do
    {b, of} = {parse(p["b"]), parse(p["of"])}

    %{
      "subset" => Interval.subset?(b, of),
      "proper_subset" => Interval.proper_subset?(b, of)
    }
  end

  defp answer("interval.coverage", p) do
    covered =
      p["of"]
      |> Enum.map(fn
        "empty" -> Interval.empty()
        [left, right] -> Interval.closed(left, right)
        text -> parse(text)
      end)
      |> Interval.coverage()

    covered
    |> properties()
    |> Map.merge(%{
      "left" => extreme(covered.left, "min"),
      "right" => extreme(covered.right, "max"),
      "empty" => Interval.empty?(covered)
    })
  end

  defp properties(interval) do
    %{
      "left" => endpoint(interval.left, interval.left_inclusive, "min"),
      "right" => endpoint(interval.right, interval.right_inclusive, "max"),
      "span" => extreme(Interval.span(interval)),
      "closed" => Interval.closed?(interval),
      "open" => Interval.open?(interval),
      "degenerate" => Interval.degenerate?(interval),
      "empty" => Interval.empty?(interval),
      "negative" => Interval.negative?(interval),
      "finite" => Interval.finite?(interval),
      "half_bounded" => Interval.half_bounded?(interval),
      "center" => extreme(Interval.center_point(interval))
    }
  end

  defp changed(interval) do
    interval
    |> properties()
    |> Map.merge(%{"interval" => notation(interval)})
  end

  defp notation(interval), do: Interval.to_string(interval)

  defp endpoint(:unbounded, inclusive, extreme),
    do: %{"bounded" => false, "inclusive" => inclusive, "point" => extreme}

  defp endpoint(point, inclusive, _extreme),
    do: %{"bounded" => true, "inclusive" => inclusive, "point" => point}

  defp extreme(:infinity), do: "max"
  defp extreme(:neg_infinity), do: "min"
  defp extreme(other), do: other
  defp extreme(:unbounded, name), do: name
  defp extreme(other, _name), do: other

  defp bound(nil), do: :unbounded
  defp bound(point), do: point

  defp point("min"), do: @min
  defp point("max"), do: -@min - 1
  defp point(point), do: point

  defp closed(%{"left" => left, "right" => right}), do: Interval.closed(bound(left), bound(right))

  defp amount(nil, nil), do: {:by, 0}
  defp amount(nil, span), do: {:by, span}
  defp amount(factor, _span), do: {:factor, factor}

  defp slice("all"), do: :all
  defp slice([from, to]), do: {from, to}
  defp slice([from, to, step]), do: {from, to, step}
  defp slice(%{"take" => indices}), do: {:take, indices}
  defp slice(at) when is_integer(at), do: at
  defp slice(other), do: Text.unknown!("a slice", other)

  defp lists(ranges), do: Enum.map(ranges, &Tuple.to_list/1)

  # "[0,10)", or text for intervals without a notation: "left=42 inclusive, right=7 exclusive
  # (negative)".
  defp parse("left=" <> _ = words) do
    [_, left, left_flag, right, right_flag] =
      Regex.run(~r/left=(-?\d+) (\w+), right=(-?\d+) (\w+)/, words)

    Interval.new(
      String.to_integer(left),
      left_flag == "inclusive",
      String.to_integer(right),
      right_flag == "inclusive"
    )
  end

  defp parse("empty"), do: Interval.empty()
  defp parse("infinite"), do: Interval.infinite()

  # An unbounded end is "inf" on both sides.
  defp parse(text) do
    text = Regex.replace(~r/^([\[(])\s*(inf|min)\s*,/, text, "\\1-inf,")
    {:ok, interval} = text |> String.replace(~r/,\s*max\s*/, ",inf") |> Interval.parse()
    interval
  end
end
