defmodule Situ.Examples.FaceRegions do
  @moduledoc """
  A pipeline that grows at run time: every face gets its own branch for as long as the face is visible.

  Images and tracked faces become a map from face id to image region. `Situ.parallel/3` opens a branch for each id; here
  the branch measures the brightness of the face, smoothed over its last half second. When a face disappears, its branch
  is closed and the branch's state is discarded.

      faces = Situ.Infer.MouthShape.parts(camera).faces
      brightness = Situ.Examples.FaceRegions.brightness(camera, faces)     # %{0 => 131.2, 1 => 98.7}
  """
  alias Situ.Stream

  @doc "Emits `%{id => mean brightness, 0..255}` for every image."
  @spec brightness(Stream.t(), Stream.t()) :: Stream.t()
  def brightness(pictures, faces) do
    pictures
    |> Situ.join(faces)
    |> Situ.map(&regions/1, type: {:map, :any, Situ.Image})
    |> Situ.parallel(fn _id, region ->
      region
      |> Situ.map(&mean/1, type: :float)
      |> Situ.average(over: {:past, Situ.Time.ms(500)})
    end)
  end

  defp regions({picture, faces}) do
    for face <- faces,
        {:ok, %Situ.Image{} = region} <- [Situ.Imaging.crop(picture, face.rect, clip: true)],
        into: %{},
        do: {face.rect.id, region}
  end

  defp mean(region) do
    {:ok, colors} = Situ.Imaging.average_color(region)
    Enum.sum(Map.values(colors)) / map_size(colors)
  end
end
