defmodule Situ.Space.RegistrationTest do
  use ExUnit.Case, async: true
  alias Situ.{CameraIntrinsics, CameraView, Image, PointCloud, Pose, Vector3}
  alias Situ.Space.{Camera, DepthCamera, Registration, SyntheticRoom, ViewImage}
  doctest Registration
  doctest ViewImage

  # A moment of the synthetic room as depth, and a later one as a larger image, after the camera has swayed.
  defp room do
    depth = frame(80, 60, 0, & &1.depth)
    color = frame(160, 120, 4, & &1.color)
    refute depth.pose == color.pose
    {depth, color}
  end

  defp frame(width, height, n, stream) do
    opts = [width: width, height: height, rate: 5, seconds: 1, sway: 0.1]

    Situ.to_list(fn p -> p |> DepthCamera.open({SyntheticRoom, opts}) |> stream.() end)
    |> Enum.at(n)
  end

  test "each depth pixel gets the color that the other camera saw there" do
    {depth, color} = room()
    {:ok, colors} = Registration.register_colors(depth, color)
    assert {colors.width, colors.height} == {80, 60}

    for x <- 5..75//7, y <- 5..55//7 do
      case Registration.project_pixel(depth, color, {x, y}) do
        {:ok, {px, py}} when px < 159 and py < 119 ->
          {:ok, seen} = Image.fetch_pixel(color.viewed, floor(px + 0.5), floor(py + 0.5))
          assert Image.fetch_pixel(colors, x, y) == {:ok, seen}

        {:ok, _edge} ->
          :ok

        {:error, why} ->
          assert why in [:outside, :unknown]
          assert Image.fetch_pixel(colors, x, y) == {:ok, [0, 0, 0]}
      end
    end

    {:ok, cloud} = DepthCamera.view_to_cloud(depth, colors: color)
    assert byte_size(cloud.colors) == 3 * PointCloud.point_count(cloud)
  end

  test "the position of a color pixel is on its ray and on the measured depth" do
    {depth, color} = room()
    {:ok, ray} = Camera.ray_in_view(color, {80.0, 60.0})

    {x, y, z} =
      place = Registration.find_point(depth, color, {80.0, 60.0}, step: 0.01, range: 10.0)

    assert Situ.Ray3.distance_to(ray, place) < 1.0e-9
    {:ok, cloud} = DepthCamera.view_to_cloud(depth)

    nearest =
      cloud |> PointCloud.to_points() |> Enum.map(&Vector3.distance(&1, {x, y, z})) |> Enum.min()

    assert nearest < 0.1
  end

  test "unsuitable input is an error" do
    {depth, color} = room()
    small = %{color | intrinsics: CameraIntrinsics.resize_to(color.intrinsics, 40, 30)}
    assert {:error, %{code: :bad_camera}} = Registration.register_colors(depth, small)
    assert {:error, %{code: :bad_image}} = Registration.register_colors(depth, depth)
    {:ok, encoded} = ViewImage.encode(color)

    assert {:error, %{code: :bad_image, fix: "decode" <> _}} =
             Registration.register_colors(depth, encoded)

    assert Registration.project_pixel(depth, color, {-1, 0}) == {:error, :unknown}
  end

  test "a resized or cropped view shows its points at the same positions" do
    {_depth, color} = room()
    {x, y} = {color.viewed.width, color.viewed.height}

    bent =
      CameraIntrinsics.new!(
        width: x,
        height: y,
        focal: {70, 72},
        radial: [0.05, -0.02],
        tangential: {0.001, -0.001}
      )

    view = %{color | intrinsics: bent}
    point = Pose.transform_point(view.pose, {2.0, 0.3, -0.2})
    {:ok, {x, y}} = Camera.project_in_view(view, point)
    {:ok, twice} = ViewImage.scale(view, 2)
    assert {twice.viewed.width, twice.viewed.height} == {320, 240}
    assert {:ok, {x2, y2}} = Camera.project_in_view(twice, point)
    assert_in_delta x2, 2 * x, 1.0e-9
    assert_in_delta y2, 2 * y, 1.0e-9
    {:ok, part} = ViewImage.crop(view, {10, 5, 60, 90})
    assert {part.viewed.width, part.intrinsics.width} == {60, 60}
    assert {:ok, {x3, _}} = Camera.project_in_view(part, point)
    assert_in_delta x3, x - 10, 1.0e-9
    assert {:error, %{code: :bad_rect}} = ViewImage.crop(view, {150, 0, 20, 10})
    assert {:error, %{code: :bad_option}} = ViewImage.scale(view, 0)
    assert {:error, %{code: :bad_option}} = ViewImage.encode(view, format: :gif)

    cloud = CameraView.new(PointCloud.from_points([]), bent, Pose.identity())
    assert {:error, %{code: :bad_image}} = ViewImage.resize(cloud, 2, 2)
    assert {:error, %{code: :bad_image}} = ViewImage.decode(view)
  end

  test "converts, encodes and decodes views" do
    {depth, color} = room()
    {:ok, gray} = ViewImage.convert(color, :gray8)
    assert gray.viewed.format == :gray8
    {:ok, jpeg} = ViewImage.encode(color, quality: 50)
    assert jpeg.viewed.format == :jpeg
    {:ok, back} = ViewImage.decode(jpeg)
    assert {back.viewed.width, back.intrinsics} == {160, color.intrinsics}
    {:ok, png} = ViewImage.encode(depth)

    assert {:ok, ^depth} =
             ViewImage.decode(png,
               depth: [scale: depth.viewed.scale, semantics: depth.viewed.semantics]
             )

    {:ok, half} = ViewImage.resize(depth, 40, 30)
    assert {half.viewed.width, half.viewed.scale} == {40, depth.viewed.scale}
  end
end
