defmodule Situ.Infer.Face.Blaze do
  @moduledoc false
  # BlazeFace short range: the input of the network and the meaning of its 896 anchors. Pure: no model and no image.
  #
  # There are two anchors for each cell of a 16x16 grid, and then six for each cell of an 8x8 grid. An anchor is only
  # a centre. For each anchor, the network returns 16 offsets in pixels of its 128-pixel input (centre, size, six key
  # points) and a score before the sigmoid.
  alias Situ.Infer.{Activation, Face, Patch}
  alias Situ.Tensor

  @size 128
  @anchors for {n, copies} <- [{16, 2}, {8, 6}],
               y <- 0..(n - 1),
               x <- 0..(n - 1),
               _ <- 1..copies,
               do: {(x + 0.5) / n * @size, (y + 0.5) / n * @size}
  @count length(@anchors)
  @row 16 * 4

  @spec input_size() :: pos_integer()
  def input_size, do: @size

  @doc "Returns the inputs and outputs that the model file must have."
  def required_ports do
    [
      inputs: %{"input" => {:f32, {1, @size, @size, 3}}},
      outputs: %{
        "regressors" => {:f32, {1, @count, 16}},
        "classificators" => {:f32, {1, @count, 1}}
      }
    ]
  end

  @doc "Returns the faces that the network found in `patch`, in image pixels, best first, before any merging."
  @spec decode_faces(%{String.t() => Tensor.t()}, Patch.t(), float()) :: [Face.t()]
  def decode_faces(%{"regressors" => boxes, "classificators" => scores}, patch, min_score) do
    logit = logit(min_score)

    collect_candidates(scores.data, logit, 0, [])
    |> Enum.sort_by(fn {index, score} -> {-score, index} end)
    |> Enum.map(fn {index, score} ->
      build_face(boxes.data, index, Activation.sigmoid(score), patch)
    end)
  end

  # Scores that are not finite numbers do not count as faces.
  defp collect_candidates(<<score::float-native-32, rest::binary>>, min, i, candidates)
       when score > min,
       do: collect_candidates(rest, min, i + 1, [{i, score} | candidates])

  defp collect_candidates(<<_::32, rest::binary>>, min, i, candidates),
    do: collect_candidates(rest, min, i + 1, candidates)

  defp collect_candidates(<<>>, _min, _i, candidates), do: candidates

  defp build_face(boxes, index, score, patch) do
    {ax, ay} = anchor_center(index)
    row = for <<v::float-native-32 <- binary_part(boxes, index * @row, @row)>>, do: v
    [cx, cy, w, h | points] = row

    [right, left, nose, mouth, right_ear, left_ear] =
      points
      |> Enum.chunk_every(2)
      |> Enum.map(fn [x, y] -> to_image_point(patch, x + ax, y + ay) end)

    {x0, y0} = to_image_point(patch, cx + ax - w / 2, cy + ay - h / 2)
    {x1, y1} = to_image_point(patch, cx + ax + w / 2, cy + ay + h / 2)

    %Face{
      rect: %Situ.Rect{
        x: x0,
        y: y0,
        width: max(x1 - x0, 0.0),
        height: max(y1 - y0, 0.0),
        label: "face",
        score: score
      },
      eyes: {right, left},
      nose: nose,
      mouth: mouth,
      ears: {right_ear, left_ear}
    }
  end

  # Offsets refer to pixel areas, but patches map pixel centres, so half a pixel is subtracted and added again.
  defp to_image_point(patch, x, y) do
    {px, py} = Patch.to_image_point(patch, {x - 0.5, y - 0.5})
    {px + 0.5, py + 0.5}
  end

  defp anchor_center(index), do: elem(unquote(Macro.escape(List.to_tuple(@anchors))), index)

  defp logit(p), do: :math.log(p / (1.0 - p))
end
