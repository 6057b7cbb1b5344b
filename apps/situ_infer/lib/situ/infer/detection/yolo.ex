defmodule Situ.Infer.Detection.Yolo do
  @moduledoc false
  # Converts the outputs of YOLO networks to boxes in pixels of the network's input. Pure.
  # `Situ.Infer.ObjectDetector` lists the output formats.
  # Formulas: Redmon and Farhadi, "YOLO9000" (2017), for v2; the exporters' documentation for the
  # other versions.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Infer.Activation
  alias Situ.Tensor

  @anchors [{1.08, 1.19}, {3.42, 4.41}, {6.63, 11.38}, {9.42, 5.11}, {16.62, 10.52}]
  @cell 32

  @type version :: :v2_tiny | :v5 | :v8 | :v10
  @type box :: %{
          x: float(),
          y: float(),
          width: float(),
          height: float(),
          class: non_neg_integer(),
          score: float(),
          mask: [float()]
        }

  @doc "Returns the supported versions."
  @spec supported_versions() :: [version()]
  def supported_versions, do: [:v2_tiny, :v5, :v8, :v10]

  @doc "Returns whether an output's shape fits that version; a v8 output has `masks` mask coefficients per box."
  @spec shape_matches?(version(), tuple(), non_neg_integer()) :: boolean()
  def shape_matches?(version, shape, masks \\ 0)
  def shape_matches?(:v2_tiny, {_, 125, h, w}, _), do: h in [-1, 13] and w in [-1, 13]
  def shape_matches?(:v5, {_, _, row}, _), do: row == -1 or row > 5
  def shape_matches?(:v8, {_, column, _}, masks), do: column == -1 or column > 4 + masks
  def shape_matches?(:v10, {_, _, row}, _), do: row in [-1, 6]
  def shape_matches?(_version, _shape, _masks), do: false

  @doc """
  Returns the boxes with a score of at least `min_score`, in no particular order. For `masks`, see `shape_matches?/3`.
  Boxes that have no size or contain values that are not numbers are left out.

      iex> row = [50.0, 40.0, 20.0, 10.0, 0.9, 0.1, 0.8]
      iex> boxes = Situ.Infer.Detection.Yolo.parse_boxes(Situ.Tensor.from_list(row, :f32, {1, 1, 7}), :v5, 0.5)
      iex> for b <- boxes, do: {b.x, b.y, b.width, b.height, b.class, Float.round(b.score, 2)}
      [{40.0, 35.0, 20.0, 10.0, 1, 0.72}]
  """
  @spec parse_boxes(Tensor.t(), version(), float(), non_neg_integer()) :: [box()]
  def parse_boxes(tensor, version, min_score, masks \\ 0)

  def parse_boxes(%Tensor{type: :f32, shape: {1, _, row}, data: data}, :v5, min_score, _masks) do
    rest = (row - 5) * 4

    for <<cx::float-native-32, cy::float-native-32, w::float-native-32, h::float-native-32,
          object::float-native-32, classes::binary-pinned_size(rest) <- data>>,
        object >= min_score,
        {class, p} <- [best_class(classes, 0, {0, 0.0})],
        object * p >= min_score,
        w > 0,
        h > 0,
        do: build_box(cx - w / 2, cy - h / 2, w, h, class, object * p)
  end

  def parse_boxes(%Tensor{type: :f32, shape: {1, _, 6}, data: data}, :v10, min_score, _masks) do
    for <<x1::float-native-32, y1::float-native-32, x2::float-native-32, y2::float-native-32,
          score::float-native-32, class::float-native-32 <- data>>,
        score >= min_score,
        x2 > x1,
        y2 > y1,
        class >= 0,
        do: build_box(x1, y1, x2 - x1, y2 - y1, round(class), score)
  end

  # Each box is a column and each class is a row, so that a scan over rows touches few numbers.
  def parse_boxes(%Tensor{type: :f32, shape: {1, rows, n}, data: data}, :v8, min_score, masks) do
    classes = rows - 4 - masks

    0..(classes - 1)//1
    |> Enum.reduce(%{}, fn class, best ->
      data
      |> binary_part((4 + class) * n * 4, n * 4)
      |> update_best_classes(0, class, min_score, best)
    end)
    |> Enum.flat_map(fn {i, {score, class}} ->
      parse_box_column(data, i, n, classes, masks, class, score)
    end)
  end

  def parse_boxes(
        %Tensor{type: :f32, shape: {1, 125, 13, 13}, data: data},
        :v2_tiny,
        min_score,
        _masks
      ) do
    for {{aw, ah}, anchor} <- Enum.with_index(@anchors),
        y <- 0..12,
        x <- 0..12,
        at = &float_at(data, ((anchor * 25 + &1) * 13 + y) * 13 + x),
        [tx, ty, tw, th, to] = Enum.map(0..4, at),
        Enum.all?([tx, ty, tw, th, to], &is_float/1),
        object = Activation.sigmoid(to),
        object >= min_score,
        {class, p} = softmax_best(Enum.map(5..24, at)),
        object * p >= min_score do
      {w, h} = {bounded_exp(tw) * aw * @cell, bounded_exp(th) * ah * @cell}
      {cx, cy} = {(x + Activation.sigmoid(tx)) * @cell, (y + Activation.sigmoid(ty)) * @cell}
      build_box(cx - w / 2, cy - h / 2, w, h, class, object * p)
    end
  end

  defp build_box(x, y, w, h, class, score, mask \\ []),
    do: %{x: x, y: y, width: w, height: h, class: class, score: score, mask: mask}

  # The float pattern does not match NaN and infinity, so the next clause skips them.
  defp best_class(<<p::float-native-32, rest::binary>>, i, {_, most}) when p > most,
    do: best_class(rest, i + 1, {i, p})

  defp best_class(<<_::32, rest::binary>>, i, best), do: best_class(rest, i + 1, best)
  defp best_class(<<>>, _i, best), do: best

  defp update_best_classes(<<p::float-native-32, rest::binary>>, i, class, min, best)
       when p >= min do
    best = Map.update(best, i, {p, class}, &if(p > elem(&1, 0), do: {p, class}, else: &1))
    update_best_classes(rest, i + 1, class, min, best)
  end

  defp update_best_classes(<<_::32, rest::binary>>, i, class, min, best),
    do: update_best_classes(rest, i + 1, class, min, best)

  defp update_best_classes(<<>>, _i, _class, _min, best), do: best

  defp parse_box_column(data, i, n, classes, masks, class, score) do
    [cx, cy, w, h] = for row <- 0..3, do: float_at(data, row * n + i)
    mask = for row <- 0..(masks - 1)//1, do: float_at(data, (4 + classes + row) * n + i)

    if Enum.all?([cx, cy, w, h | mask], &is_float/1) and w > 0 and h > 0,
      do: [build_box(cx - w / 2, cy - h / 2, w, h, class, score, mask)],
      else: []
  end

  defp float_at(data, i) do
    case binary_part(data, i * 4, 4) do
      <<x::float-native-32>> -> x
      _ -> nil
    end
  end

  defp softmax_best(values) do
    {p, class} =
      values
      |> Enum.map(&(&1 || -1.0e30))
      |> Activation.softmax()
      |> Enum.with_index()
      |> Enum.max_by(&elem(&1, 0))

    {class, p}
  end

  defp bounded_exp(x), do: :math.exp(min(max(x, -20.0), 20.0))
end
