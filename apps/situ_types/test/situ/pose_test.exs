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

  property "composing with the inverse gives back every point" do
    forall {pose, point} <- {pose(), vector()} do
      assert near?(Pose.transform(Pose.invert(pose), Pose.transform(pose, point)), point)
      assert near?(Pose.transform(Pose.compose(pose, Pose.invert(pose)), point), point)
    end
  end

  property "composition is one transformation after the other" do
    forall {a, b, point} <- {pose(), pose(), vector()} do
      assert near?(
               Pose.transform(Pose.compose(a, b), point),
               Pose.transform(a, Pose.transform(b, point))
             )
    end
  end

  property "a matrix and Euler angles give the rotation back" do
    forall {pose, point} <- {pose(), vector()} do
      assert {:ok, again} = pose |> Pose.to_matrix() |> Pose.from_matrix()
      assert near?(Pose.transform(again, point), Pose.transform(pose, point), 1.0e-4)

      {yaw, pitch, roll} = Quaternion.to_euler(pose.rotation)
      turned = Quaternion.from_euler(yaw, pitch, roll)

      assert near?(
               Quaternion.rotate(turned, point),
               Quaternion.rotate(pose.rotation, point),
               1.0e-4
             )
    end
  end

  property "interpolation begins at one pose, ends at the other and turns at constant speed" do
    forall {a, b, percent} <- {pose(), pose(), integer(0, 100)} do
      assert near?(Pose.interpolate(a, b, 0).position, a.position)
      assert Quaternion.angle(Pose.interpolate(a, b, 1).rotation, b.rotation) < 1.0e-6

      whole = Quaternion.angle(a.rotation, b.rotation)
      part = Quaternion.angle(a.rotation, Pose.interpolate(a, b, percent / 100).rotation)
      assert_in_delta part, whole * percent / 100, 1.0e-6
    end
  end

  property "interpolation is the same for both signs of a rotation, and backwards" do
    forall {a, b, percent} <- {pose(), pose(), integer(0, 100)} do
      {w, x, y, z} = b.rotation
      there = Quaternion.slerp(a.rotation, b.rotation, percent / 100)
      same = Quaternion.slerp(a.rotation, {-w, -x, -y, -z}, percent / 100)

      if Quaternion.angle(a.rotation, b.rotation) < 3.14,
        do: assert(Quaternion.angle(there, same) < 1.0e-6)

      assert Quaternion.slerp(a.rotation, b.rotation, percent / 100) == there

      # Half a turn has two shortest ways.
      if Quaternion.angle(a.rotation, b.rotation) < 3.14 do
        back = Quaternion.slerp(b.rotation, a.rotation, 1 - percent / 100)
        assert Quaternion.angle(there, back) < 1.0e-6
      end
    end
  end

  test "numbers without a fraction are numbers, too" do
    half = Quaternion.slerp({1, 0, 0, 0}, {0, 0, 0, 1}, 0.5)
    assert Quaternion.angle(half, Quaternion.from_euler(:math.pi() / 2, 0, 0)) < 1.0e-9
    pose = %Pose{position: {1, 0, 0}, rotation: {0, 0, 0, 1}}
    assert Pose.compose(pose, pose).position == {0, 0, 0}
  end

  property "rotation keeps lengths and angles" do
    forall {pose, u, v} <- {pose(), vector(), vector()} do
      {ru, rv} = {Quaternion.rotate(pose.rotation, u), Quaternion.rotate(pose.rotation, v)}
      assert_in_delta Vector3.dot(ru, rv), Vector3.dot(u, v), 1.0e-5
    end
  end

  property "what is stored is read back, whatever else is stored is refused" do
    forall {pose, bytes} <- {pose(), binary()} do
      assert {:ok, ^pose} = pose |> Pose.encode() |> Pose.decode()
      assert {:error, %Situ.Error{}} = Pose.decode(bytes)
    end
  end

  test "matrices that scale, mirror or project are refused" do
    scaled = [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1]
    mirrored = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    projective = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 1]

    for matrix <- [scaled, mirrored, projective, [1, 2, 3]],
        do: assert({:error, %Situ.Error{code: :degenerate_pose}} = Pose.from_matrix(matrix))
  end

  test "a stored rotation of no length or beyond all numbers is refused" do
    for {w, code} <- [{0.0, :degenerate_pose}, {1.0e300, :degenerate_pose}] do
      bytes =
        for value <- [0.0, 0.0, 0.0, w, 0.0, 0.0, 0.0],
            into: <<1, 0::56>>,
            do: <<value::little-float-64>>

      assert {:error, %Situ.Error{code: ^code}} = Pose.decode(bytes)
    end
  end
end
