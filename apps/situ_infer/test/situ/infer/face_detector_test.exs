defmodule Situ.Infer.FaceDetectorTest do
  use ExUnit.Case, async: true

  alias Situ.{Image, Imaging, Rect}
  alias Situ.Infer.{FaceDetector, FaceLandmarks, Mouth}

  @fixtures Path.expand("../../fixtures", __DIR__)

  defp picture(name) do
    {:ok, image} = Imaging.read(Path.join(@fixtures, name))
    image
  end

  test "finds the one face of the photo, and its points" do
    image = picture("astronaut.png")
    assert {:ok, [face]} = FaceDetector.detect(image)
    assert Rect.iou(face.rect, Rect.new!(178, 82, 93, 92)) > 0.6

    {:ok, model} = FaceLandmarks.load([])
    assert {:ok, [mesh]} = FaceLandmarks.find(model, image, [face])
    assert mesh.score > 0.9
    {x, y} = Situ.Infer.FaceMesh.point(mesh, 13)
    assert_in_delta x, 223, 15
    assert_in_delta y, 143, 15
    assert Mouth.opening(mesh) > 0.02 and Mouth.opening(mesh) < 0.2
  end

  test "finds no face in a cup of coffee" do
    assert {:ok, []} = FaceDetector.detect(picture("coffee_noface.png"))
  end

  test "a picture of 16-bit channels is refused" do
    assert {:error, %{code: :bad_image}} = FaceDetector.detect(Image.filled(64, 64, :gray16))
  end

  # Real faces of these sizes in a real picture of 1920x1080 without any.
  for px <- [40, 55, 80] do
    test "faces of #{px} pixels are found in 1080p, and where they are" do
      scale = unquote(px) / 92

      cup =
        picture("coffee_noface.png") |> Imaging.convert!(:bgr24) |> Imaging.resize!(1920, 1080)

      astronaut = picture("astronaut.png") |> Imaging.convert!(:bgr24)
      small = Imaging.scale!(astronaut, scale, scale, filter: :area)
      places = [{37, 21}, {900, 480}, {1400, 650}]
      crowd = Enum.reduce(places, cup, fn place, image -> Imaging.paste!(image, small, place) end)
      assert {:ok, faces} = FaceDetector.detect(crowd)
      assert length(faces) == 3

      for {x, y} <- places do
        truth = Rect.new!(x + 178 * scale, y + 82 * scale, 93 * scale, 92 * scale)
        assert Enum.any?(faces, &(Rect.iou(&1.rect, truth) > 0.6))
      end
    end
  end

  test "tiles: 0 looks at the whole picture only" do
    assert {:ok, [_]} = FaceDetector.detect(picture("astronaut.png"), tiles: 0)
  end
end
