defmodule Situ.Space.CameraTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{CameraIntrinsics, CameraView, Pose, Quaternion, Ray3, Vector3}
  alias Situ.Space.Camera
  doctest Camera

  # A wide lens, as in a depth camera.
  defp camera(opts \\ []) do
    CameraIntrinsics.new!(
      [
        width: 640,
        height: 576,
        focal: {505, 505},
        principal: {322.1, 334.9},
        radial: [0.2, -0.1, 0.01, 0.15, -0.05, 0.005],
        tangential: {1.0e-4, -2.0e-4}
      ] ++ opts
    )
  end

  property "projecting a pixel at a depth and back returns the same pixel" do
    forall {px, py, depth} <- {integer(0, 639), integer(0, 575), integer(1, 800)} do
      for inverse? <- [true, false], semantics <- [:plane, :point] do
        camera = camera(distorts?: inverse?)
        depth = depth / 100

        with {:ok, point} <- Camera.unproject(camera, {px, py}, depth, semantics: semantics),
             {:ok, {x, y}} <- Camera.project(camera, point, outside: true) do
          assert_in_delta x, px, 1.0e-3
          assert_in_delta y, py, 1.0e-3
          measured = if semantics == :point, do: Vector3.norm(point), else: elem(point, 0)
          assert_in_delta measured, depth, 1.0e-9
        else
          other -> flunk("#{inspect(other)} at #{px}, #{py}")
        end
      end
    end
  end

  property "undistorting finds the point that was distorted" do
    forall {x, y} <- {integer(-60, 60), integer(-60, 60)} do
      point = {x / 100, y / 100}
      assert {:ok, {u, v}} = Camera.undistort(camera(), Camera.distort(camera(), point))
      assert_in_delta u, x / 100, 1.0e-6
      assert_in_delta v, y / 100, 1.0e-6
    end
  end

  test "the model's derivatives are correct where Newton's method needs few steps" do
    # A strong lens whose closed form folds back. There is no solution beyond the fold, and the functions report
    # this.
    strong = CameraIntrinsics.new!(width: 100, height: 100, focal: {50, 50}, radial: [-0.5])
    assert {:ok, _} = Camera.undistort(strong, {0.4, 0.2})
    assert :error = Camera.undistort(strong, {3.0, 3.0})
    assert {:error, :not_invertible} = Camera.unproject(strong, {350.0, 350.0}, 1.0)
  end

  test "rejects points behind the camera and outside the image" do
    assert {:error, :behind} = Camera.project(camera(), {0.0, 1.0, 1.0})
    assert {:error, :outside} = Camera.project(camera(), {1.0, 5.0, 0.0}, distort: false)

    assert {:ok, {x, _}} =
             Camera.project(camera(), {1.0, 5.0, 0.0}, distort: false, outside: true)

    assert x < 0
  end

  property "a view's ray through a pixel passes through the point that the pixel shows" do
    forall {y, z, yaw} <- {integer(-30, 30), integer(-30, 30), integer(-314, 314)} do
      pose = Pose.new({1.0, -2.0, 0.5}, Quaternion.from_euler(yaw / 100, 0.1, -0.2))
      view = CameraView.new(:picture, camera(), pose)
      point = Pose.transform_point(pose, {2.0, y / 50, z / 50})
      {:ok, pixel} = Camera.project_in_view(view, point, outside: true)
      {:ok, ray} = Camera.ray_in_view(view, pixel)
      assert Ray3.distance_to(ray, point) < 1.0e-6
    end
  end
end
