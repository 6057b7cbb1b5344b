defmodule Situ.Studio.Visualizers.Shapes do
  @moduledoc """
  Rectangles, points, lines and texts over pictures, found in any term: a `Situ.Rect`, a `Situ.Point2`, lists, tuples
  and
  maps of them, and structs that have some in their fields (a face with its box and landmarks).

  A struct whose points are packed offers them through `points/1` of its module, as `[{x, y}]`.

      iex> Situ.Studio.Visualizers.Shapes.of([%Situ.Point2{x: 1.0, y: 2.0}])
      %{"points" => [[1.0, 2.0, nil]], "rects" => [], "texts" => []}
  """
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, Visualizer}
  alias Situ.Studio.Visualizers.Option

  @limit 5_000
  @depth 6

  @impl true
  def about do
    options =
      Option.visible() ++
        [color: [type: :color, title: "Colour", auto: "by identity", several: true]] ++
        [
          labels: [type: :boolean, title: "Labels", default: true],
          width: [type: {:range, 0.5, 8}, title: "Width", default: 2],
          radius: [type: {:range, 0.5, 20}, title: "Point radius"]
        ] ++ Option.near()

    %Visualizer{
      id: "shapes",
      title: "Shapes over pictures",
      panel: :image,
      shapes: [:shapes],
      options: options,
      asks: Option.asks()
    }
  end

  @impl true
  def instant(channel, data, message),
    do: Frame.json(channel, message.originating_time, of(data))

  @doc "The shapes to draw, as the page reads them."
  @spec of(term()) :: map()
  def of(term) do
    {rects, points, texts, _} = walk(term, nil, {[], [], [], @limit}, 0)

    %{
      "rects" => Enum.reverse(rects),
      "points" => Enum.reverse(points),
      "texts" => Enum.reverse(texts)
    }
  end

  @doc "Whether there is anything to draw in `term`."
  @spec any?(term()) :: boolean()
  def any?(term) do
    {rects, points, _, _} = walk(term, nil, {[], [], [], 50}, 0)
    rects != [] or points != []
  end

  defp walk(_, _, {_, _, _, 0} = acc, _), do: acc
  defp walk(_, _, acc, @depth), do: acc

  defp walk(%Situ.Rect{} = r, label, {rects, points, texts, left}, _) do
    case r do
      %{x: x, y: y, width: w, height: h}
      when is_number(x) and is_number(y) and is_number(w) and is_number(h) ->
        name = text(Map.get(r, :label) || label)
        rect = [x, y, w, h, name, number(Map.get(r, :score)), id(Map.get(r, :id))]
        {[rect | rects], points, texts, left - 1}

      _ ->
        {rects, points, texts, left - 1}
    end
  end

  defp walk(%Situ.Point2{x: x, y: y}, label, {rects, points, texts, left}, _)
       when is_number(x) and is_number(y),
       do: {rects, [[x, y, text(label)] | points], texts, left - 1}

  defp walk(%module{}, _, acc, _) when module in [Situ.Image, Situ.AudioBuffer, Situ.DepthImage],
    do: acc

  defp walk(%module{} = struct, _label, acc, depth) do
    {rects, points, texts, left} = acc
    packed = packed(module, struct, left)
    acc = {rects, packed ++ points, texts, left - length(packed)}
    fields = Map.from_struct(struct)
    own = if is_binary(fields[:label]) or is_atom(fields[:label]), do: fields[:label]
    fields |> Map.values() |> Enum.reduce(acc, &walk(&1, own, &2, depth + 1))
  end

  defp walk(map, _, acc, depth) when is_map(map) do
    Enum.reduce(map, acc, fn {key, value}, acc ->
      walk(value, if(is_binary(key) or is_atom(key), do: key), acc, depth + 1)
    end)
  end

  defp walk([head | tail], label, acc, depth) do
    walk_tail(tail, label, walk(head, label, acc, depth + 1), depth)
  end

  # A rectangle with its name beside it.
  defp walk({%Situ.Rect{} = rect, label}, _, acc, depth) when is_binary(label),
    do: walk(rect, label, acc, depth)

  defp walk({label, %Situ.Rect{} = rect}, _, acc, depth) when is_binary(label),
    do: walk(rect, label, acc, depth)

  defp walk(tuple, label, acc, depth) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> Enum.reduce(acc, &walk(&1, label, &2, depth + 1))

  defp walk(_, _, acc, _), do: acc

  # A file may claim anything to be a mesh: one that its own module cannot read is not drawn.
  defp packed(module, struct, left) do
    if function_exported?(module, :points, 1) do
      for {x, y} when is_number(x) and is_number(y) <- Enum.take(module.points(struct), left),
          do: [Float.round(x / 1, 1), Float.round(y / 1, 1), nil]
    else
      []
    end
  rescue
    _ -> []
  end

  defp walk_tail([head | tail], label, acc, depth),
    do: walk_tail(tail, label, walk(head, label, acc, depth + 1), depth)

  defp walk_tail(_, _, acc, _), do: acc

  defp text(nil), do: nil
  defp text(label) when is_atom(label), do: Atom.to_string(label)
  defp text(label) when is_number(label), do: to_string(label)

  defp text(label) when is_binary(label),
    do: if(String.valid?(label), do: String.slice(label, 0, 80), else: inspect(label))

  defp text(_), do: nil

  defp number(x) when is_number(x), do: x
  defp number(_), do: nil

  defp id(id) when is_integer(id), do: id
  defp id(nil), do: nil
  defp id(id), do: :erlang.phash2(id, 8)
end
