defmodule Situ.Infer.Vision.TextRegions do
  @moduledoc false
  # Finds text regions in a map of each pixel's probability of being text. For each connected
  # region it returns the narrowest rectangle around it, slightly enlarged. Pure.
  #
  # A rectangle may be rotated: `right` is the reading direction, `width` is along it and `height`
  # across it. A rectangle that is much higher than wide is read downwards.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Tensor

  @schema [
    threshold: [
      type: {:range, 0, 1},
      default: 0.3,
      doc: "Pixels above this probability are text."
    ],
    min_score: [type: {:range, 0, 1}, default: 0.5, doc: "The minimum mean of a region's pixels."],
    wider: [
      type: {:range, 0, 5},
      default: 1.6,
      doc:
        "How far a rectangle grows on each side, as a factor of its area divided by its perimeter."
    ],
    min_side: [
      type: {:range, 1, 100},
      default: 3,
      doc: "The minimum side of a rectangle, in pixels."
    ]
  ]
  @most 1_000

  @type region :: %{
          center: {float(), float()},
          right: {float(), float()},
          width: float(),
          height: float(),
          score: float()
        }

  @doc """
  Returns the regions in a map of the shape `{1, 1, height, width}`, in its pixels, at most #{@most}.

  #{Situ.Options.docs(@schema)}

      iex> row = fn ones -> for x <- 0..9, into: <<>>, do: <<if(x in ones, do: 0.9, else: 0.0)::float-native-32>> end
      iex> map = row.([]) <> row.(2..7) <> row.(2..7) <> row.(2..7) <> row.([])
      iex> [region] = Situ.Infer.Vision.TextRegions.find_regions(Situ.Tensor.new(map, :f32, {1, 1, 5, 10}), min_side: 2)
      iex> {region.center, Float.round(region.score, 1), region.width > region.height}
      {{4.5, 2.0}, 0.9, true}
  """
  @spec find_regions(Tensor.t(), keyword()) :: [region()]
  def find_regions(%Tensor{type: :f32, shape: {1, 1, _height, width}, data: data}, opts \\ []) do
    opts = Situ.Options.validate!(opts, @schema)

    data
    |> collect_rows(width, opts[:threshold], 0, [])
    |> group_runs()
    |> Enum.take(@most)
    |> Enum.flat_map(&build_region(&1, opts))
  end

  # Collects the runs of each row: {first, last, sum of probabilities}.
  defp collect_rows(<<>>, _width, _threshold, _y, rows), do: Enum.reverse(rows)

  defp collect_rows(data, width, threshold, y, rows) do
    <<row::binary-pinned_size(width * 4), rest::binary>> = data

    collect_rows(rest, width, threshold, y + 1, [
      {y, collect_runs(row, 0, threshold, nil, [])} | rows
    ])
  end

  defp collect_runs(<<p::float-native-32, rest::binary>>, x, threshold, nil, runs)
       when p > threshold,
       do: collect_runs(rest, x + 1, threshold, {x, p}, runs)

  defp collect_runs(<<p::float-native-32, rest::binary>>, x, threshold, {from, sum}, runs)
       when p > threshold,
       do: collect_runs(rest, x + 1, threshold, {from, sum + p}, runs)

  defp collect_runs(<<_::32, rest::binary>>, x, threshold, nil, runs),
    do: collect_runs(rest, x + 1, threshold, nil, runs)

  defp collect_runs(<<_::32, rest::binary>>, x, threshold, {from, sum}, runs),
    do: collect_runs(rest, x + 1, threshold, nil, [{from, x - 1, sum} | runs])

  defp collect_runs(<<>>, x, _threshold, {from, sum}, runs),
    do: Enum.reverse([{from, x - 1, sum} | runs])

  defp collect_runs(<<>>, _x, _threshold, nil, runs), do: Enum.reverse(runs)

  # Runs of neighbouring rows that touch, even at a corner, belong to the same region.
  defp group_runs(rows) do
    {parents, _above, all} =
      Enum.reduce(rows, {%{}, [], []}, fn {y, runs}, {parents, above, all} ->
        named = Enum.with_index(runs, fn run, i -> {{y, i}, run} end)
        parents = Enum.reduce(named, parents, fn {id, _}, parents -> Map.put(parents, id, id) end)

        {join_adjacent_rows(named, above, parents), named,
         Enum.map(named, fn {id, run} -> {id, y, run} end) ++ all}
      end)

    all
    |> Enum.group_by(fn {id, _, _} -> find_root(parents, id) end, fn {_, y, run} -> {y, run} end)
    |> Enum.sort()
    |> Enum.map(&elem(&1, 1))
  end

  defp join_adjacent_rows([], _above, parents), do: parents
  defp join_adjacent_rows(_here, [], parents), do: parents

  defp join_adjacent_rows(
         [{id, {from, to, _}} | later] = here,
         [{other, {above_from, above_to, _}} | rest] = above,
         parents
       ) do
    parents =
      if from <= above_to + 1 and above_from <= to + 1,
        do: unite_groups(parents, id, other),
        else: parents

    if above_to < to,
      do: join_adjacent_rows(here, rest, parents),
      else: join_adjacent_rows(later, above, parents)
  end

  defp unite_groups(parents, a, b) do
    case {find_root(parents, a), find_root(parents, b)} do
      {same, same} -> parents
      {a, b} -> Map.put(parents, max(a, b), min(a, b))
    end
  end

  defp find_root(parents, id) do
    case parents do
      %{^id => ^id} -> id
      %{^id => parent} -> find_root(parents, parent)
    end
  end

  defp build_region(runs, opts) do
    {sum, count} =
      Enum.reduce(runs, {0.0, 0}, fn {_, {from, to, p}}, {sum, count} ->
        {sum + p, count + to - from + 1}
      end)

    score = sum / count

    rectangle =
      runs
      |> Enum.flat_map(fn {y, {from, to, _}} -> [{from, y}, {to, y}] end)
      |> convex_hull()
      |> narrowest_rect()

    if score >= opts[:min_score] and
         min(rectangle.width, rectangle.height) + 1 >= opts[:min_side],
       do: [rectangle |> grow_rect(opts[:wider]) |> orient_upright() |> Map.put(:score, score)],
       else: []
  end

  # Andrew's monotone chain.
  defp convex_hull(points) do
    points = points |> Enum.sort() |> Enum.dedup()
    lower = build_chain(points)
    upper = points |> Enum.reverse() |> build_chain()

    case tl(lower) ++ tl(upper) do
      [] -> points
      hull -> hull
    end
  end

  defp build_chain(points), do: points |> Enum.reduce([], &add_hull_point/2) |> Enum.reverse()

  defp add_hull_point(point, [b, a | rest] = chain),
    do:
      if(cross_product(a, b, point) <= 0,
        do: add_hull_point(point, [a | rest]),
        else: [point | chain]
      )

  defp add_hull_point(point, chain), do: [point | chain]

  defp cross_product({ax, ay}, {bx, by}, {cx, cy}),
    do: (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

  # One side of the narrowest rectangle is parallel to a side of the hull.
  defp narrowest_rect(hull) do
    hull
    |> Enum.zip(tl(hull) ++ [hd(hull)])
    |> Enum.map(fn {{ax, ay}, {bx, by}} ->
      length = :math.sqrt((bx - ax) * (bx - ax) + (by - ay) * (by - ay))
      if length > 0, do: {(bx - ax) / length, (by - ay) / length}, else: {1.0, 0.0}
    end)
    |> Enum.uniq()
    |> Enum.map(&bounding_rect(hull, &1))
    |> Enum.min_by(&(&1.width * &1.height))
  end

  defp bounding_rect(points, {ux, uy} = right) do
    {left, far} = points |> Enum.map(fn {x, y} -> x * ux + y * uy end) |> Enum.min_max()
    {top, low} = points |> Enum.map(fn {x, y} -> y * ux - x * uy end) |> Enum.min_max()
    {u, v} = {(left + far) / 2, (top + low) / 2}

    %{
      center: {u * ux - v * uy, u * uy + v * ux},
      right: right,
      width: far - left,
      height: low - top
    }
  end

  defp grow_rect(rectangle, ratio) do
    {w, h} = {rectangle.width + 1, rectangle.height + 1}
    by = 2 * (w * h * ratio / (2 * (w + h)))
    %{rectangle | width: w + by, height: h + by}
  end

  # Text is read to the right and not upside down, and downwards if the rectangle is much higher than wide.
  defp orient_upright(%{right: {ux, uy}, width: w, height: h} = rectangle) do
    {{ux, uy}, w, h} = if abs(ux) >= abs(uy), do: {{ux, uy}, w, h}, else: {{-uy, ux}, h, w}
    {ux, uy} = if ux < 0, do: {-ux, -uy}, else: {ux, uy}
    {right, w, h} = if h >= 1.5 * w, do: {{-uy, ux}, h, w}, else: {{ux, uy}, w, h}
    %{rectangle | right: right, width: w, height: h}
  end
end
