defmodule Situ.Infer.BodyPoseTest do
  use ExUnit.Case, async: true

  alias Situ.{Image, ImageOps, Point2, Skeleton}
  alias Situ.Infer.{BodyPose, FaceDetector}

  @fixtures Path.expand("../../fixtures", __DIR__)

  defp picture(name), do: @fixtures |> Path.join(name) |> ImageOps.read() |> elem(1)
  defp named(points), do: BodyPose.joint_names() |> Enum.zip(points) |> Map.new()

  defp near?(%Point2{x: x, y: y}, {tx, ty}, by), do: abs(x - tx) < by and abs(y - ty) < by

  test "places the points where another network sees the face and where the shoulders are" do
    image = picture("astronaut.png")
    {:ok, [%{eyes: {right, left}, nose: nose}]} = FaceDetector.detect(image)
    assert {:ok, %{points: points, skeletons: [body]}} = BodyPose.find_body(image)
    assert length(points) == 33
    at = named(points)
    assert near?(at.right_eye, right, 12) and near?(at.left_eye, left, 12)
    assert near?(at.nose, nose, 15)
    # Below the chin at y = 185, on either side of the neck at x = 225.
    assert at.right_shoulder.x < 180 and at.left_shoulder.x > 250
    for name <- [:left_shoulder, :right_shoulder], do: assert_in_delta(at[name].y, 205, 50)

    assert body.confidence.nose > 0.9
    {_, left, up} = Skeleton.joint_position(body, :left_shoulder)
    {_, right, _} = Skeleton.joint_position(body, :right_shoulder)
    # She faces the camera, so her left is on its right.
    assert left < right and up > 0.2
    assert_in_delta right - left, 0.33, 0.12
  end

  test "follows a moving person and reports nobody without one" do
    # A camera that turns by 12 pixels per image; then a wall, then the person again.
    photo = "astronaut.png" |> picture() |> ImageOps.convert!(:bgr24)
    turned = for i <- 0..3, do: ImageOps.crop!(photo, {i * 12, 0, 440, 512})
    wall = Image.new_filled(440, 512, :bgr24, {128, 128, 128})

    assert [a, _, _, d, [], again] =
             Situ.to_list(fn p ->
               p
               |> Situ.from_enumerable(turned ++ [wall, hd(turned)], every: 1)
               |> Situ.map(& &1, type: Image)
               |> Situ.via(BodyPose)
               |> Map.fetch!(:out)
             end)

    [a, d, again] = Enum.map([a, d, again], &named/1)
    assert_in_delta a.nose.x - d.nose.x, 36, 12
    assert near?(again.nose, {a.nose.x, a.nose.y}, 1)
  end

  test "finds no body in a cup of coffee, on a wall or in one pixel" do
    nobody = %{points: [], skeletons: []}
    assert {:ok, ^nobody} = BodyPose.find_body(picture("coffee_noface.png"))

    for {w, h} <- [{640, 480}, {1, 1}, {1, 2_000}],
        do: assert({:ok, ^nobody} = BodyPose.find_body(Image.new_filled(w, h, :gray8, 90)))
  end

  test "rejects images with 16-bit channels and networks of another shape" do
    assert {:error, %{code: :bad_image}} = BodyPose.find_body(Image.new_filled(64, 64, :gray16))

    assert {:error, %{code: :model_shape, what: what}} =
             BodyPose.find_body(Image.new_filled(64, 64, :gray8),
               model: Situ.Infer.Model.bundled_path("person.onnx")
             )

    assert what =~ "person.onnx"
  end
end
