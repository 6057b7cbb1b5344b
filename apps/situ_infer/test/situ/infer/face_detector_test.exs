defmodule Situ.Infer.FaceDetectorTest do
  use ExUnit.Case, async: true

  alias Situ.{Image, ImageOps, Rect}
  alias Situ.Infer.{FaceDetector, FaceLandmarks, Mouth}

  @fixtures Path.expand("../../fixtures", __DIR__)

  defp picture(name) do
    {:ok, image} = ImageOps.read(Path.join(@fixtures, name))
    image
  end

  test "finds the single face in the photo and its points" do
    image = picture("astronaut.png")
    assert {:ok, [face]} = FaceDetector.detect(image)
    assert Rect.iou(face.rect, Rect.new!(178, 82, 93, 92)) > 0.6

    {:ok, model} = FaceLandmarks.load_network([])
    assert {:ok, [mesh]} = FaceLandmarks.find_meshes(model, image, [face])
    assert mesh.score > 0.9
    {x, y} = Situ.Infer.FaceMesh.point_at(mesh, 13)
    assert_in_delta x, 223, 15
    assert_in_delta y, 143, 15
    assert Mouth.measure_opening(mesh) > 0.02 and Mouth.measure_opening(mesh) < 0.2
  end

  test "finds no face in a cup of coffee" do
    assert {:ok, []} = FaceDetector.detect(picture("coffee_noface.png"))
  end

  test "rejects an image with 16-bit channels" do
    assert {:error, %{code: :bad_image}} = FaceDetector.detect(Image.new_filled(64, 64, :gray16))
  end

  # Real faces of these sizes, pasted into a real 1920x1080 image that contains no faces.
  for px <- [40, 55, 80] do
    test "finds faces of #{px} pixels at their positions in 1080p" do
      scale = unquote(px) / 92

      cup =
        picture("coffee_noface.png") |> ImageOps.convert!(:bgr24) |> ImageOps.resize!(1920, 1080)

      astronaut = picture("astronaut.png") |> ImageOps.convert!(:bgr24)
      small = ImageOps.scale!(astronaut, scale, scale, filter: :area)
      places = [{37, 21}, {900, 480}, {1400, 650}]

      crowd =
        Enum.reduce(places, cup, fn place, image -> ImageOps.paste!(image, small, place) end)

      assert {:ok, faces} = FaceDetector.detect(crowd)
      assert length(faces) == 3

      for {x, y} <- places do
        truth = Rect.new!(x + 178 * scale, y + 82 * scale, 93 * scale, 92 * scale)
        assert Enum.any?(faces, &(Rect.iou(&1.rect, truth) > 0.6))
      end
    end
  end

  test "tiles: 0 searches only the whole image" do
    assert {:ok, [_]} = FaceDetector.detect(picture("astronaut.png"), tiles: 0)
  end
end
