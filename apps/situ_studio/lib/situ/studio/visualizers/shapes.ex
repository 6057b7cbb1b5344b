defmodule Situ.Studio.Visualizers.Shapes do
  @moduledoc false
  # Draws rectangles, points, lines and texts over images. It finds them in any term: a
  # `Situ.Rect`, a `Situ.Point2`, a line (a pair of points, or a map of two points `from` and
  # `to`), lists, tuples and maps of them, and structs with such fields (a face with its box and
  # landmarks). A trail shows where they were in the last seconds.
  #
  # A struct with packed points provides them through `points/1` of its module, as `[{x, y}]`.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, ValuePath, Visualizer, StreamReader}
  alias Situ.Studio.Visualizers.SharedOptions

  @limit 5_000
  @depth 6
  # A trail consists of at most this many messages, with at most this many shapes of each kind.
  @past 300
  @trailed 200

  @impl true
  def about do
    options =
      SharedOptions.visible() ++
        [color: [type: :color, title: "Colour", auto: "by identity", several: true]] ++
        [
          labels: [type: :boolean, title: "Labels", default: true],
          width: [type: {:range, 0.5, 8}, title: "Width", default: 2],
          radius: [type: {:range, 0.5, 20}, title: "Point radius"],
          trail: [type: {:range, 0, 60}, title: "Trail, s", default: 0]
        ] ++ SharedOptions.near_cursor()

    %Visualizer{
      id: "shapes",
      title: "Shapes over images",
      panel: :image,
      shapes: [:shapes],
      options: options,
      asks: [:trail | SharedOptions.requested_keys()]
    }
  end

  @impl true
  def instant(channel, data, %{originating_time: time}, %{source: source, spec: spec}) do
    shapes = collect_shapes(data)

    case spec[:props] do
      %{"trail" => seconds} when is_number(seconds) and seconds > 0 ->
        trail = read_trail(source, spec, {time - round(seconds * 1.0e9), time})
        Frame.json(channel, time, Map.put(shapes, "trail", trail))

      _ ->
        Frame.json(channel, time, shapes)
    end
  end

  # Returns `[age, points, lines]` of earlier messages. The age is a share of the trail's duration (1 at its end).
  defp read_trail(source, spec, {from, to}) do
    for %{originating_time: time, data: data} <- past_messages(source, spec.stream, from, to - 1),
        {:ok, data} <- [ValuePath.fetch(data, spec.path)] do
      shapes = collect_shapes(data)
      middle = for [x, y, w, h, _, _, id] <- shapes["rects"], do: [x + w / 2, y + h / 2, id]
      points = for [x, y, _] <- shapes["points"], do: [x, y, nil]
      age = Float.round((to - time) / max(to - from, 1), 3)
      [age, Enum.take(middle ++ points, @trailed), Enum.take(shapes["lines"], @trailed)]
    end
  end

  defp past_messages(source, stream, from, to) do
    case StreamReader.read_messages(source, stream, from, to, @past) do
      {:ok, messages, :all} -> messages
      {:ok, _, :more} -> sample_messages(source, stream, from, to)
      _ -> []
    end
  end

  defp sample_messages(source, stream, from, to) do
    case StreamReader.sample_messages(source, stream, from, to, @past) do
      {:ok, rows} -> Enum.map(rows, &elem(&1, 1))
      _ -> []
    end
  end

  @doc """
  Returns the shapes to draw, in the page's format.

      iex> Situ.Studio.Visualizers.Shapes.collect_shapes([%Situ.Point2{x: 1.0, y: 2.0}])
      %{"lines" => [], "points" => [[1.0, 2.0, nil]], "rects" => [], "texts" => []}
      iex> point = &%Situ.Point2{x: &1, y: &2}
      iex> Situ.Studio.Visualizers.Shapes.collect_shapes([{point.(1, 2), point.(3, 4)}, nil])["lines"]
      [[1, 2, 3, 4]]
  """
  @spec collect_shapes(term()) :: map()
  def collect_shapes(term) do
    {rects, points, texts, _} = collect_term(term, nil, {[], [], [], @limit}, 0)
    {lines, points} = Enum.split_with(points, &match?([_, _, _, _], &1))

    %{
      "lines" => Enum.reverse(lines),
      "rects" => Enum.reverse(rects),
      "points" => Enum.reverse(points),
      "texts" => Enum.reverse(texts)
    }
  end

  @doc "Returns whether `term` contains anything to draw."
  @spec any?(term()) :: boolean()
  def any?(term) do
    {rects, points, _, _} = collect_term(term, nil, {[], [], [], 50}, 0)
    rects != [] or points != []
  end

  defp collect_term(_, _, {_, _, _, 0} = acc, _), do: acc
  defp collect_term(_, _, acc, @depth), do: acc

  defp collect_term(%Situ.Rect{} = r, label, {rects, points, texts, left}, _) do
    case r do
      %{x: x, y: y, width: w, height: h}
      when is_number(x) and is_number(y) and is_number(w) and is_number(h) ->
        name = label_text(Map.get(r, :label) || label)
        rect = [x, y, w, h, name, number_or_nil(Map.get(r, :score)), numeric_id(Map.get(r, :id))]
        {[rect | rects], points, texts, left - 1}

      _ ->
        {rects, points, texts, left - 1}
    end
  end

  defp collect_term(%Situ.Point2{x: x, y: y}, label, {rects, points, texts, left}, _)
       when is_number(x) and is_number(y),
       do: {rects, [[x, y, label_text(label)] | points], texts, left - 1}

  # Lines are collected with the points, and are separated from them at the end.
  defp collect_term({%Situ.Point2{} = a, %Situ.Point2{} = b}, _, acc, _), do: add_line(a, b, acc)

  defp collect_term(%{from: %Situ.Point2{} = a, to: %Situ.Point2{} = b}, _, acc, _),
    do: add_line(a, b, acc)

  defp collect_term(%module{}, _, acc, _)
       when module in [Situ.Image, Situ.AudioBuffer, Situ.DepthImage],
       do: acc

  defp collect_term(%module{} = struct, _label, acc, depth) do
    {rects, points, texts, left} = acc
    packed = packed_points(module, struct, left)
    acc = {rects, packed ++ points, texts, left - length(packed)}
    fields = Map.from_struct(struct)
    own = if is_binary(fields[:label]) or is_atom(fields[:label]), do: fields[:label]
    fields |> Map.values() |> Enum.reduce(acc, &collect_term(&1, own, &2, depth + 1))
  end

  defp collect_term(map, _, acc, depth) when is_map(map) do
    Enum.reduce(map, acc, fn {key, value}, acc ->
      collect_term(value, if(is_binary(key) or is_atom(key), do: key), acc, depth + 1)
    end)
  end

  defp collect_term([head | tail], label, acc, depth) do
    collect_tail(tail, label, collect_term(head, label, acc, depth + 1), depth)
  end

  # A pair of a rectangle and its name is one labelled rectangle.
  defp collect_term({%Situ.Rect{} = rect, label}, _, acc, depth) when is_binary(label),
    do: collect_term(rect, label, acc, depth)

  defp collect_term({label, %Situ.Rect{} = rect}, _, acc, depth) when is_binary(label),
    do: collect_term(rect, label, acc, depth)

  defp collect_term(tuple, label, acc, depth) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> Enum.reduce(acc, &collect_term(&1, label, &2, depth + 1))

  defp collect_term(_, _, acc, _), do: acc

  defp add_line(%{x: a, y: b}, %{x: c, y: d}, {rects, points, texts, left})
       when is_number(a) and is_number(b) and is_number(c) and is_number(d),
       do: {rects, [[a, b, c, d] | points], texts, left - 1}

  defp add_line(_, _, acc), do: acc

  # A file may contain invalid structs. Those that their own module cannot read are not drawn.
  defp packed_points(module, struct, left) do
    if function_exported?(module, :points, 1) do
      for {x, y} when is_number(x) and is_number(y) <- Enum.take(module.points(struct), left),
          do: [Float.round(x / 1, 1), Float.round(y / 1, 1), nil]
    else
      []
    end
  rescue
    _ -> []
  end

  defp collect_tail([head | tail], label, acc, depth),
    do: collect_tail(tail, label, collect_term(head, label, acc, depth + 1), depth)

  defp collect_tail(_, _, acc, _), do: acc

  defp label_text(nil), do: nil
  defp label_text(label) when is_atom(label), do: Atom.to_string(label)
  defp label_text(label) when is_number(label), do: to_string(label)

  defp label_text(label) when is_binary(label),
    do: if(String.valid?(label), do: String.slice(label, 0, 80), else: inspect(label))

  defp label_text(_), do: nil

  defp number_or_nil(x) when is_number(x), do: x
  defp number_or_nil(_), do: nil

  defp numeric_id(id) when is_integer(id), do: id
  defp numeric_id(nil), do: nil
  defp numeric_id(id), do: :erlang.phash2(id, 8)
end
