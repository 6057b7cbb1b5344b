defmodule Situ.PoseTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Pose, Quaternion, Vector3}
  doctest Pose
  doctest Quaternion
  doctest Vector3

  defp coordinate, do: map(integer(-5_000, 5_000), &(&1 / 100))
  defp vector, do: {coordinate(), coordinate(), coordinate()}
  defp angle, do: map(integer(-314, 314), &(&1 / 100))

  defp pose do
    map({vector(), angle(), angle(), angle()}, fn {position, yaw, pitch, roll} ->
      Pose.new(position, Quaternion.from_euler(yaw, pitch, roll))
    end)
  end

  defp near?(a, b, tolerance \\ 1.0e-6), do: Vector3.distance(a, b) < tolerance

  property "composing with the inverse returns every point" do
    forall {pose, point} <- {pose(), vector()} do
      assert near?(
               Pose.transform_point(Pose.invert(pose), Pose.transform_point(pose, point)),
               point
             )

      assert near?(Pose.transform_point(Pose.compose(pose, Pose.invert(pose)), point), point)
    end
  end

  property "composition applies one transformation after the other" do
    forall {a, b, point} <- {pose(), pose(), vector()} do
      assert near?(
               Pose.transform_point(Pose.compose(a, b), point),
               Pose.transform_point(a, Pose.transform_point(b, point))
             )
    end
  end

  property "a matrix and Euler angles preserve the rotation" do
    forall {pose, point} <- {pose(), vector()} do
      assert {:ok, again} = pose |> Pose.to_matrix() |> Pose.from_matrix()
      assert near?(Pose.transform_point(again, point), Pose.transform_point(pose, point), 1.0e-4)

      {yaw, pitch, roll} = Quaternion.to_euler(pose.rotation)
      turned = Quaternion.from_euler(yaw, pitch, roll)

      assert near?(
               Quaternion.rotate_vector(turned, point),
               Quaternion.rotate_vector(pose.rotation, point),
               1.0e-4
             )
    end
  end

  property "interpolation goes from one pose to the other and rotates at constant speed" do
    forall {a, b, percent} <- {pose(), pose(), integer(0, 100)} do
      assert near?(Pose.interpolate(a, b, 0).position, a.position)
      assert Quaternion.angle_between(Pose.interpolate(a, b, 1).rotation, b.rotation) < 1.0e-6

      whole = Quaternion.angle_between(a.rotation, b.rotation)
      part = Quaternion.angle_between(a.rotation, Pose.interpolate(a, b, percent / 100).rotation)
      assert_in_delta part, whole * percent / 100, 1.0e-6
    end
  end

  property "interpolation is symmetric and does not depend on the sign of a rotation" do
    forall {a, b, percent} <- {pose(), pose(), integer(0, 100)} do
      {w, x, y, z} = b.rotation
      there = Quaternion.slerp(a.rotation, b.rotation, percent / 100)
      same = Quaternion.slerp(a.rotation, {-w, -x, -y, -z}, percent / 100)

      if Quaternion.angle_between(a.rotation, b.rotation) < 3.14,
        do: assert(Quaternion.angle_between(there, same) < 1.0e-6)

      assert Quaternion.slerp(a.rotation, b.rotation, percent / 100) == there

      # For half a turn there are two shortest paths.
      if Quaternion.angle_between(a.rotation, b.rotation) < 3.14 do
        back = Quaternion.slerp(b.rotation, a.rotation, 1 - percent / 100)
        assert Quaternion.angle_between(there, back) < 1.0e-6
      end
    end
  end

  test "accepts integers" do
    half = Quaternion.slerp({1, 0, 0, 0}, {0, 0, 0, 1}, 0.5)
    assert Quaternion.angle_between(half, Quaternion.from_euler(:math.pi() / 2, 0, 0)) < 1.0e-9
    pose = %Pose{position: {1, 0, 0}, rotation: {0, 0, 0, 1}}
    assert Pose.compose(pose, pose).position == {0, 0, 0}
  end

  property "rotation preserves lengths and angles" do
    forall {pose, u, v} <- {pose(), vector(), vector()} do
      {ru, rv} =
        {Quaternion.rotate_vector(pose.rotation, u), Quaternion.rotate_vector(pose.rotation, v)}

      assert_in_delta Vector3.dot_product(ru, rv), Vector3.dot_product(u, v), 1.0e-5
    end
  end

  property "a stored pose round-trips, and other bytes are refused" do
    forall {pose, bytes} <- {pose(), binary()} do
      assert {:ok, ^pose} = pose |> Pose.encode() |> Pose.decode()
      assert {:error, %Situ.Error{}} = Pose.decode(bytes)
    end
  end

  test "refuses matrices that scale, mirror or project" do
    scaled = [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1]
    mirrored = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    projective = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 1]

    for matrix <- [scaled, mirrored, projective, [1, 2, 3]],
        do: assert({:error, %Situ.Error{code: :degenerate_pose}} = Pose.from_matrix(matrix))
  end

  test "refuses a stored rotation of zero or infinite length" do
    for {w, code} <- [{0.0, :degenerate_pose}, {1.0e300, :degenerate_pose}] do
      bytes =
        for value <- [0.0, 0.0, 0.0, w, 0.0, 0.0, 0.0],
            into: <<1, 0::56>>,
            do: <<value::little-float-64>>

      assert {:error, %Situ.Error{code: ^code}} = Pose.decode(bytes)
    end
  end
end
