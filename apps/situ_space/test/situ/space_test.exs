defmodule Situ.SpaceTest do
  use ExUnit.Case, async: true
  alias Situ.{ImuReading, Point3, Pose, Quaternion, Space, Vector3}
  doctest Space

  @second 1_000_000_000

  defp poses(p, every) do
    rows =
      for i <- 0..4,
          do: {i * every, Pose.new({i * 1.0, 0.0, 0.0}, Quaternion.from_euler(i * 0.2, 0, 0))}

    Situ.from_enumerable(p, rows, type: Pose)
  end

  defp run(build),
    do: Situ.to_list(fn p -> Situ.map(build.(p), &{&2.originating_time, &1}) end)

  test "interpolates poses at the times of another stream" do
    seen =
      run(fn p ->
        ticks = Situ.from_enumerable(p, [{5, :a}, {15, :b}, {40, :c}, {90, :late}])
        Situ.join(ticks, poses(p, 10), Space.between())
      end)

    assert [{5, {:a, first}}, {15, {:b, _}}, {40, {:c, last}}] = seen
    assert first.position == {0.5, 0.0, 0.0}
    assert_in_delta first.rotation |> Quaternion.to_euler() |> elem(0), 0.1, 1.0e-12
    assert last.position == {4.0, 0.0, 0.0}
  end

  test "computes velocities from one message to the next" do
    assert [{@second, v} | rest] = run(fn p -> Space.velocity(poses(p, @second)) end)
    assert {v.direction, v.magnitude} == {{1.0, 0.0, 0.0}, 1.0}
    assert length(rest) == 3
    [{_, turn} | _] = run(fn p -> Space.velocity(poses(p, @second), kind: :angular) end)
    assert_in_delta turn.magnitude, 0.2, 1.0e-9
    [{_, both} | _] = run(fn p -> Space.velocity(poses(p, @second), kind: :pose) end)
    assert both.linear == {1.0, 0.0, 0.0}
    assert_in_delta Vector3.norm(both.angular), 0.2, 1.0e-9
  end

  test "transforms data from a moving frame to the outer frame" do
    seen =
      run(fn p ->
        p
        |> Situ.from_enumerable([{10, Point3.new(0, 1, 0)}, {20, Point3.new(0, 0, 0)}])
        |> Space.transform_stream(poses(p, 10))
      end)

    expected =
      Pose.transform_point(
        Pose.new({1.0, 0.0, 0.0}, Quaternion.from_euler(0.2, 0, 0)),
        {0.0, 1.0, 0.0}
      )

    assert [{10, a}, {20, b}] = seen
    assert Vector3.distance({a.x, a.y, a.z}, expected) < 1.0e-12
    assert {b.x, b.y, b.z} == {2.0, 0.0, 0.0}
  end

  test "computes the orientation from sensor readings" do
    readings =
      for i <- 0..100, do: {i * 10_000_000, ImuReading.new({0.0, 0.0, 9.81}, {0.0, 0.0, 0.5})}

    seen = run(fn p -> p |> Situ.from_enumerable(readings) |> Space.orientation(gain: 1) end)
    assert length(seen) == 101
    {_, q} = List.last(seen)
    assert_in_delta q |> Quaternion.to_euler() |> elem(0), 0.5, 1.0e-9
  end
end
