defmodule Situ.Space.CalibrationTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{CameraIntrinsics, Pose, Quaternion, Vector3}
  alias Situ.Space.{Calibration, Camera, LeastSquares}
  doctest Calibration
  doctest LeastSquares

  @points for y <- -3..3, z <- -2..2, x <- [1.5, 2.4], do: {x, y * 0.18 * x, z * 0.19 * x}

  defp camera do
    map(
      {integer(400, 700), integer(400, 700), integer(-30, 30), integer(-20, 20),
       integer(-100, 100), integer(-50, 50), integer(-3, 3)},
      fn
        {fx, fy, dx, dy, k1, k2, p} ->
          CameraIntrinsics.new!(
            width: 640,
            height: 480,
            focal: {fx, fy},
            principal: {320 + dx, 240 + dy},
            radial: [k1 / 1000, k2 / 1000],
            tangential: {p / 1000, -p / 2000}
          )
      end
    )
  end

  defp seen(camera, pose \\ Pose.identity()) do
    for point <- @points,
        {:ok, pixel} <- [Camera.project(camera, point)],
        do: {Pose.transform_point(pose, point), pixel}
  end

  @tag numtests: 4
  property "finds the camera that captured the points" do
    forall camera <- camera() do
      assert {:ok, found} = Calibration.calibrate_camera(seen(camera), {640, 480})
      assert found.error < 1.0e-4

      for {a, b} <- pairs(camera, found.intrinsics),
          do: assert_in_delta(a, b, 0.01 + 1.0e-4 * abs(a))
    end
  end

  defp pairs(a, b) do
    flat =
      &(Tuple.to_list(&1.focal) ++
          Tuple.to_list(&1.principal) ++ Tuple.to_list(&1.radial) ++ Tuple.to_list(&1.tangential))

    Enum.zip(flat.(a), flat.(b))
  end

  test "also finds the pose of the camera" do
    camera = CameraIntrinsics.new!(width: 640, height: 480, focal: {510, 515}, radial: [0.05])
    pose = Pose.new({0.4, -0.2, 1.3}, Quaternion.from_euler(0.3, -0.1, 0.05))
    start = Pose.new({0.2, 0.0, 1.0}, Quaternion.from_euler(0.2, 0.0, 0.0))

    assert {:ok, found} =
             Calibration.calibrate_camera(seen(camera, pose), {640, 480},
               pose: true,
               start: start,
               distortion: :radial
             )

    assert Vector3.distance(found.pose.position, pose.position) < 1.0e-3
    assert Quaternion.angle_between(found.pose.rotation, pose.rotation) < 1.0e-3
    assert_in_delta elem(found.intrinsics.focal, 0), 510, 0.5
  end

  test "reports the error in pixels" do
    camera = CameraIntrinsics.new!(width: 640, height: 480, focal: {520, 520})
    :rand.seed(:exsss, {1, 2, 3})

    noisy =
      for {point, {u, v}} <- seen(camera),
          do: {point, {u + 0.3 * :rand.normal(), v + 0.3 * :rand.normal()}}

    assert {:ok, found} = Calibration.calibrate_camera(noisy, {640, 480}, distortion: :none)
    assert_in_delta found.error, 0.3 * :math.sqrt(2), 0.1
    assert_in_delta elem(found.intrinsics.focal, 0), 520, 3.0
  end

  test "insufficient input is an error" do
    assert {:error, %{code: :too_few}} =
             Calibration.calibrate_camera([{{1.0, 0.0, 0.0}, {1.0, 1.0}}], {640, 480})

    assert {:error, %{code: :bad_option}} =
             Calibration.calibrate_camera(
               List.duplicate({{:nan, 0.0, 0.0}, {1.0, 1.0}}, 20),
               {640, 480}
             )

    assert {:error, %{code: :bad_option}} =
             Calibration.calibrate_camera(List.duplicate(:point, 20), {640, 480})

    behind =
      for {{x, y, z}, pixel} <-
            seen(CameraIntrinsics.new!(width: 640, height: 480, focal: {500, 500})),
          do: {{-x, y, z}, pixel}

    assert {:error, %{code: :not_found}} = Calibration.calibrate_camera(behind, {640, 480})
    :rand.seed(:exsss, {4, 5, 6})

    mixed =
      for {point, _} <- seen(CameraIntrinsics.new!(width: 640, height: 480, focal: {500, 500})),
          do: {point, {:rand.uniform() * 640, :rand.uniform() * 480}}

    assert {:error, %{code: :not_found}} =
             Calibration.calibrate_camera(mixed, {640, 480}, distortion: :none, rounds: 20)
  end
end
