defmodule Situ.Studio.Scene.Gathered do
  @moduledoc false
  # Collects the small objects of a message, so that a thousand boxes become one item.
  alias Situ.{Box3, Pose, Quaternion, Skeleton}
  alias Situ.Studio.Scene

  defstruct left: 0,
            items: [],
            nodes: [],
            arrows: [],
            lines: [],
            boxes: [],
            texts: [],
            problems: []

  @type t :: %__MODULE__{}

  @spec new(pos_integer()) :: t()
  def new(limit), do: %__MODULE__{left: limit}

  @spec item(t(), Scene.item()) :: t()
  def item(g, item), do: %{g | items: [item | g.items], left: g.left - 1}

  @spec problem(t(), String.t()) :: t()
  def problem(g, what), do: %{g | problems: [what | g.problems], left: g.left - 1}

  @spec node(t(), tuple(), String.t() | nil) :: t()
  def node(g, at, label) do
    g = %{g | nodes: [{at, label || "point"} | g.nodes], left: g.left - 1}
    text(g, at, label)
  end

  @spec arrow(t(), tuple(), tuple(), tuple() | nil, String.t()) :: t()
  def arrow(g, from, to, color, name),
    do: %{g | arrows: [{from, to, color, name} | g.arrows], left: g.left - 1}

  @spec line(t(), tuple(), tuple(), String.t()) :: t()
  def line(g, from, to, name),
    do: %{g | lines: [{from, to, nil, name} | g.lines], left: g.left - 1}

  @spec text(t(), tuple(), String.t() | nil) :: t()
  def text(g, _at, nil), do: g
  def text(g, at, text), do: %{g | texts: [{at, text} | g.texts], left: g.left - 1}

  @spec box(t(), Box3.t(), String.t() | nil) :: t()
  def box(g, %Box3{} = box, label) do
    rotation = if box.pose, do: box.pose.rotation, else: Quaternion.identity()
    {{a, b, c}, {d, e, f}, {h, i, j}} = Quaternion.to_matrix(rotation)
    {sx, sy, sz} = Box3.size(box)
    {x, y, z} = center = Box3.center(box)

    matrix =
      [a * sx, d * sx, h * sx, 0, b * sy, e * sy, i * sy, 0] ++
        [c * sz, f * sz, j * sz, 0, x, y, z, 1]

    text(%{g | boxes: [{matrix, label || "box"} | g.boxes], left: g.left - 1}, center, label)
  end

  @spec skeleton(t(), Skeleton.t(), String.t() | nil) :: t()
  def skeleton(g, %Skeleton{} = body, label) do
    name = if body.id == nil, do: label || "body", else: "body #{inspect(body.id)}"
    nodes = Map.new(body.joints, fn {joint, %Pose{position: at}} -> {joint, at} end)
    graph(g, nodes, body.bones, name, &Map.get(body.confidence, &1, 1.0))
  end

  @doc "Adds nodes by key and edges between keys. Reports edges to missing nodes as a problem."
  @spec graph(t(), map(), list(), String.t() | nil, (term() -> number())) :: t()
  def graph(g, nodes, edges, label, confidence \\ fn _ -> 1.0 end) do
    keys = nodes |> Map.keys() |> Enum.sort()
    places = keys |> Enum.with_index() |> Map.new()
    {good, bad} = Enum.split_with(edges, &edge?(&1, places))
    edge = Enum.flat_map(good, fn {a, b} -> [places[a], places[b]] end)
    position = Enum.flat_map(keys, &coordinates(nodes[&1]))
    sure = for key <- keys, into: <<>>, do: <<round(255 * clamp(confidence.(key)))>>
    numbers = [position: Scene.floats(position), edge: Scene.integers(edge), confidence: sure]
    meta = %{"names" => Enum.map(keys, &"#{label} #{text_of(&1)}"), "edges" => length(good)}
    g = item(g, Scene.item(:graphs, length(keys), numbers, meta))
    if bad == [], do: g, else: problem(g, "#{length(bad)} edges name nodes that are not there")
  end

  defp edge?({a, b}, places), do: is_map_key(places, a) and is_map_key(places, b)
  defp edge?(_, _), do: false

  defp coordinates(%{x: x, y: y, z: z}), do: [x, y, z]
  defp coordinates({x, y, z}), do: [x, y, z]
  defp coordinates(_), do: [:nan, :nan, :nan]

  defp clamp(x) when is_number(x), do: x |> max(0.0) |> min(1.0)
  defp clamp(_), do: 0.0

  defp text_of(key) when is_atom(key) or is_binary(key) or is_number(key), do: to_string(key)
  defp text_of(key), do: inspect(key, limit: 5)

  @spec items(t()) :: {[Scene.item()], [String.t()]}
  def items(g) do
    small =
      nodes(Enum.reverse(g.nodes)) ++
        lines(Enum.reverse(g.arrows), true) ++
        lines(Enum.reverse(g.lines), false) ++ boxes(Enum.reverse(g.boxes))

    {Enum.reverse(g.items) ++ small ++ texts(Enum.reverse(g.texts)),
     g.problems |> Enum.reverse() |> Enum.uniq()}
  end

  defp nodes([]), do: []

  defp nodes(nodes) do
    position = Enum.flat_map(nodes, fn {at, _} -> coordinates(at) end)
    numbers = [position: Scene.floats(position), edge: <<>>]
    [Scene.item(:graphs, length(nodes), numbers, %{"names" => names(nodes), "edges" => 0})]
  end

  defp lines([], _arrow), do: []

  # Lines with and without their own colours become separate items.
  defp lines(lines, arrow) do
    {plain, colored} = Enum.split_with(lines, fn {_, _, color, _} -> color == nil end)

    for group <- [plain, colored], group != [] do
      position = Enum.flat_map(group, fn {a, b, _, _} -> Tuple.to_list(a) ++ Tuple.to_list(b) end)
      color = for {_, _, {r, g, b}, _} <- group, into: <<>>, do: <<r, g, b>>

      numbers =
        [position: Scene.floats(position)] ++ if(color == <<>>, do: [], else: [color: color])

      meta = %{"arrow" => arrow, "names" => Enum.map(group, &elem(&1, 3))}
      Scene.item(:lines, length(group), numbers, meta)
    end
  end

  defp boxes([]), do: []

  defp boxes(boxes) do
    matrices = Enum.flat_map(boxes, &elem(&1, 0))
    meta = %{"names" => names(boxes)}
    [Scene.item(:boxes, length(boxes), [matrix: Scene.floats(matrices)], meta)]
  end

  defp texts([]), do: []

  defp texts(texts) do
    position = Enum.flat_map(texts, fn {at, _} -> Tuple.to_list(at) end)

    [
      Scene.item(:texts, length(texts), [position: Scene.floats(position)], %{
        "names" => names(texts)
      })
    ]
  end

  defp names(rows), do: Enum.map(rows, &elem(&1, 1))
end
