defmodule Situ.Examples.Scene.Crop do
  @moduledoc """
  Finds people in a camera's image: computes the rectangle around a body's joints, and crops the image around it.

      iex> alias Situ.Examples.Scene.Crop
      iex> rect = Situ.Rect.new!(x: 10, y: 10, width: 5, height: 5)
      iex> {rect, [point]} = Crop.shift_detection({rect, [Situ.Point2.new(12, 12)]}, {4, 2})
      iex> {rect.x, rect.y, point.x, point.y}
      {6, 8, 8, 10}
  """
  alias Situ.{CameraView, Image, ImageOps, Pose, Rect, Skeleton}
  alias Situ.Space.Camera

  @type detection :: {Rect.t(), [Situ.Point2.t()]}

  # The body extends beyond its joints by about this fraction of the rectangle.
  @margin 0.12

  @doc """
  Returns the rectangle around the joints visible to the camera, and these joints. The score is the share of the body's
  joints that are visible.
  """
  @spec body_detection(CameraView.t(), Skeleton.t()) :: detection()
  def body_detection(%CameraView{} = view, %Skeleton{} = body) do
    seen =
      for {_, %Pose{position: at}} <- Enum.sort(body.joints),
          {:ok, {x, y}} <- [Camera.project_in_view(view, at)],
          do: {x, y}

    {joints_rect(seen, length(seen) / map_size(body.joints), body.id),
     Enum.map(seen, fn {x, y} -> Situ.Point2.new(x, y) end)}
  end

  defp joints_rect([], _score, id),
    do: Rect.new!(x: 0, y: 0, width: 1, height: 1, label: "out of sight", score: 0.0, id: id)

  defp joints_rect(seen, score, id) do
    {xs, ys} = Enum.unzip(seen)
    {x0, x1, y0, y1} = {Enum.min(xs), Enum.max(xs), Enum.min(ys), Enum.max(ys)}
    {dx, dy} = {max(x1 - x0, 10) * @margin, max(y1 - y0, 10) * @margin}
    box = [x: x0 - dx, y: y0 - dy, width: x1 - x0 + 2 * dx, height: y1 - y0 + 2 * dy]
    Rect.new!(box ++ [label: "person", score: score, id: id])
  end

  @doc "Crops an image around a detection, and returns the cropped image and its offset."
  @spec crop_around(Image.t(), detection()) :: {Image.t(), {non_neg_integer(), non_neg_integer()}}
  def crop_around(%Image{width: w, height: h} = picture, {rect, _joints}) do
    {left, top} = {clamp(rect.x - rect.width, w - 8), clamp(rect.y - 8, h - 8)}
    width = min(w - left, max(8, round(rect.width * 3)))
    height = min(h - top, max(8, round(rect.height + 16)))
    {ImageOps.crop!(picture, {left, top, width, height}), {left, top}}
  end

  defp clamp(x, most), do: x |> round() |> max(0) |> min(most)

  @doc """
  Returns the detections whose center is within the image.

      iex> alias Situ.Examples.Scene.Crop
      iex> [near, far] = for x <- [0, 9], do: {Situ.Rect.new!(x: x, y: 0, width: 2, height: 2), []}
      iex> Crop.filter_inside([near, far], Situ.Image.new_filled(8, 8, :gray8)) == [near]
      true
  """
  @spec filter_inside([detection()], Image.t()) :: [detection()]
  def filter_inside(found, %Image{width: w, height: h}) do
    for {rect, _} = detection <- found,
        {x, y} = {rect.x + rect.width / 2, rect.y + rect.height / 2},
        x >= 0 and x < w and y >= 0 and y < h,
        do: detection
  end

  @doc "Converts a detection to the coordinates of an image that was cropped at this offset."
  @spec shift_detection(detection(), {number(), number()}) :: detection()
  def shift_detection({rect, joints}, {dx, dy}) do
    {%{rect | x: rect.x - dx, y: rect.y - dy},
     Enum.map(joints, &%{&1 | x: &1.x - dx, y: &1.y - dy})}
  end
end
