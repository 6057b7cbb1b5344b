defmodule Situ.Studio.Scene.ItemCollector do
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

  @spec add_item(t(), Scene.item()) :: t()
  def add_item(g, item), do: %{g | items: [item | g.items], left: g.left - 1}

  @spec add_problem(t(), String.t()) :: t()
  def add_problem(g, what), do: %{g | problems: [what | g.problems], left: g.left - 1}

  @spec add_node(t(), tuple(), String.t() | nil) :: t()
  def add_node(g, at, label) do
    g = %{g | nodes: [{at, label || "point"} | g.nodes], left: g.left - 1}
    add_text(g, at, label)
  end

  @spec add_arrow(t(), tuple(), tuple(), tuple() | nil, String.t()) :: t()
  def add_arrow(g, from, to, color, name),
    do: %{g | arrows: [{from, to, color, name} | g.arrows], left: g.left - 1}

  @spec add_line(t(), tuple(), tuple(), String.t()) :: t()
  def add_line(g, from, to, name),
    do: %{g | lines: [{from, to, nil, name} | g.lines], left: g.left - 1}

  @spec add_text(t(), tuple(), String.t() | nil) :: t()
  def add_text(g, _at, nil), do: g
  def add_text(g, at, text), do: %{g | texts: [{at, text} | g.texts], left: g.left - 1}

  @spec add_box(t(), Box3.t(), String.t() | nil) :: t()
  def add_box(g, %Box3{} = box, label) do
    rotation = if box.pose, do: box.pose.rotation, else: Quaternion.identity()
    {{a, b, c}, {d, e, f}, {h, i, j}} = Quaternion.to_matrix(rotation)
    {sx, sy, sz} = Box3.axis_lengths(box)
    {x, y, z} = center = Box3.center_point(box)

    matrix =
      [a * sx, d * sx, h * sx, 0, b * sy, e * sy, i * sy, 0] ++
        [c * sz, f * sz, j * sz, 0, x, y, z, 1]

    add_text(%{g | boxes: [{matrix, label || "box"} | g.boxes], left: g.left - 1}, center, label)
  end

  @spec add_skeleton(t(), Skeleton.t(), String.t() | nil) :: t()
  def add_skeleton(g, %Skeleton{} = body, label) do
    name = if body.id == nil, do: label || "body", else: "body #{inspect(body.id)}"
    nodes = Map.new(body.joints, fn {joint, %Pose{position: at}} -> {joint, at} end)
    add_graph(g, nodes, body.bones, name, &Map.get(body.confidence, &1, 1.0))
  end

  @doc "Adds nodes by key and edges between keys. Reports edges to missing nodes as a problem."
  @spec add_graph(t(), map(), list(), String.t() | nil, (term() -> number())) :: t()
  def add_graph(g, nodes, edges, label, confidence \\ fn _ -> 1.0 end) do
    keys = nodes |> Map.keys() |> Enum.sort()
    places = keys |> Enum.with_index() |> Map.new()
    {good, bad} = Enum.split_with(edges, &known_edge?(&1, places))
    edge = Enum.flat_map(good, fn {a, b} -> [places[a], places[b]] end)
    position = Enum.flat_map(keys, &coordinate_list(nodes[&1]))
    sure = for key <- keys, into: <<>>, do: <<round(255 * clamp(confidence.(key)))>>

    numbers = [
      position: Scene.encode_floats(position),
      edge: Scene.encode_integers(edge),
      confidence: sure
    ]

    meta = %{"names" => Enum.map(keys, &"#{label} #{text_of(&1)}"), "edges" => length(good)}
    g = add_item(g, Scene.new_item(:graphs, length(keys), numbers, meta))

    if bad == [],
      do: g,
      else: add_problem(g, "#{length(bad)} edges refer to missing nodes")
  end

  defp known_edge?({a, b}, places), do: is_map_key(places, a) and is_map_key(places, b)
  defp known_edge?(_, _), do: false

  defp coordinate_list(%{x: x, y: y, z: z}), do: [x, y, z]
  defp coordinate_list({x, y, z}), do: [x, y, z]
  defp coordinate_list(_), do: [:nan, :nan, :nan]

  defp clamp(x) when is_number(x), do: x |> max(0.0) |> min(1.0)
  defp clamp(_), do: 0.0

  defp text_of(key) when is_atom(key) or is_binary(key) or is_number(key), do: to_string(key)
  defp text_of(key), do: inspect(key, limit: 5)

  @spec to_items(t()) :: {[Scene.item()], [String.t()]}
  def to_items(g) do
    small =
      node_items(Enum.reverse(g.nodes)) ++
        line_items(Enum.reverse(g.arrows), true) ++
        line_items(Enum.reverse(g.lines), false) ++ box_items(Enum.reverse(g.boxes))

    {Enum.reverse(g.items) ++ small ++ text_items(Enum.reverse(g.texts)),
     g.problems |> Enum.reverse() |> Enum.uniq()}
  end

  defp node_items([]), do: []

  defp node_items(nodes) do
    position = Enum.flat_map(nodes, fn {at, _} -> coordinate_list(at) end)
    numbers = [position: Scene.encode_floats(position), edge: <<>>]

    [
      Scene.new_item(:graphs, length(nodes), numbers, %{"names" => row_names(nodes), "edges" => 0})
    ]
  end

  defp line_items([], _arrow), do: []

  # Lines with and without their own colours become separate items.
  defp line_items(lines, arrow) do
    {plain, colored} = Enum.split_with(lines, fn {_, _, color, _} -> color == nil end)

    for group <- [plain, colored], group != [] do
      position = Enum.flat_map(group, fn {a, b, _, _} -> Tuple.to_list(a) ++ Tuple.to_list(b) end)
      color = for {_, _, {r, g, b}, _} <- group, into: <<>>, do: <<r, g, b>>

      numbers =
        [position: Scene.encode_floats(position)] ++
          if(color == <<>>, do: [], else: [color: color])

      meta = %{"arrow" => arrow, "names" => Enum.map(group, &elem(&1, 3))}
      Scene.new_item(:lines, length(group), numbers, meta)
    end
  end

  defp box_items([]), do: []

  defp box_items(boxes) do
    matrices = Enum.flat_map(boxes, &elem(&1, 0))
    meta = %{"names" => row_names(boxes)}
    [Scene.new_item(:boxes, length(boxes), [matrix: Scene.encode_floats(matrices)], meta)]
  end

  defp text_items([]), do: []

  defp text_items(texts) do
    position = Enum.flat_map(texts, fn {at, _} -> Tuple.to_list(at) end)

    [
      Scene.new_item(:texts, length(texts), [position: Scene.encode_floats(position)], %{
        "names" => row_names(texts)
      })
    ]
  end

  defp row_names(rows), do: Enum.map(rows, &elem(&1, 1))
end
