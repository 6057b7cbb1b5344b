defmodule Situ.Examples.FaceRegions do
  @moduledoc """
  A pipeline that grows at run time: every face gets its own branch for as long as the face is visible.

  Images and tracked faces become a map from face id to image region. `Situ.parallel/3` opens a branch for each id; here
  the branch measures the brightness of the face, smoothed over its last half second. When a face disappears, its branch
  is closed and the branch's state is discarded.

      faces = Situ.Infer.MouthShape.detect_stages(camera).faces
      brightness = Situ.Examples.FaceRegions.face_brightness(camera, faces)     # %{0 => 131.2, 1 => 98.7}
  """
  alias Situ.Stream

  @doc "Emits `%{id => mean brightness, 0..255}` for every image."
  @spec face_brightness(Stream.t(), Stream.t()) :: Stream.t()
  def face_brightness(pictures, faces) do
    pictures
    |> Situ.join(faces)
    |> Situ.map(&crop_faces/1, type: {:map, :any, Situ.Image})
    |> Situ.parallel(fn _id, region ->
      region
      |> Situ.map(&mean_brightness/1, type: :float)
      |> Situ.average(over: {:past, Situ.Time.ms(500)})
    end)
  end

  defp crop_faces({picture, faces}) do
    for face <- faces,
        {:ok, %Situ.Image{} = region} <- [Situ.ImageOps.crop(picture, face.rect, clip: true)],
        into: %{},
        do: {face.rect.id, region}
  end

  defp mean_brightness(region) do
    {:ok, colors} = Situ.ImageOps.average_color(region)
    Enum.sum(Map.values(colors)) / map_size(colors)
  end
end
