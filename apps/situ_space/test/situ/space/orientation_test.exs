defmodule Situ.Space.OrientationTest do
  use ExUnit.Case, async: true
  alias Situ.{ImuReading, Quaternion, Vector3}
  alias Situ.Space.Orientation
  alias Situ.Space.SyntheticRoom.Scene
  doctest Orientation

  @data Path.expand("../../data", __DIR__)
  @degree :math.pi() / 180

  defp rows(file) do
    for line <- @data |> Path.join(file) |> File.stream!() |> Stream.drop(1) do
      for text <- line |> String.trim() |> String.split(","), do: text |> Float.parse() |> elem(0)
    end
  end

  # An NGIMU held in the hand for 10 s, with the orientation that the device computed. Its quaternions rotate from
  # the Earth's axes to the sensor's, so they are the inverse of ours.
  defp recorded do
    for {[t, gx, gy, gz, ax, ay, az, mx, my, mz | _], [_, w, x, y, z]} <-
          Enum.zip(rows("ngimu_sensors.csv"), rows("ngimu_quaternion.csv")) do
      force = Vector3.scale({ax, ay, az}, 9.80665)
      turn = Vector3.scale({gx, gy, gz}, @degree)

      {round(t * 1.0e9), ImuReading.new(force, turn, {mx, my, mz}),
       Quaternion.invert({w, x, y, z})}
    end
  end

  defp errors(opts) do
    [{_, _, first} | _] = recorded = recorded()
    start = Orientation.new([start: first] ++ opts)

    {errors, _} =
      Enum.map_reduce(recorded, start, fn {time, reading, truth}, o ->
        o = Orientation.update(o, reading, time)
        {Quaternion.angle_between(o.rotation, truth) / @degree, o}
      end)

    errors
  end

  defp mean(list), do: Enum.sum(list) / length(list)

  test "matches a device's own orientation within a degree on average" do
    errors = errors([])
    assert length(errors) == 499
    assert mean(errors) < 1.0
    assert Enum.max(errors) < 5.0
  end

  test "without the magnetic field the heading drifts, and without gain everything drifts" do
    with_field = mean(errors([]))
    without = mean(errors(magnetometer: false))
    assert with_field < without and without < 4.0
    assert mean(errors(gain: 0.0)) > with_field
  end

  test "finds the up direction from any start" do
    reading = ImuReading.new({0.0, 0.0, 9.8}, {0.0, 0.0, 0.0})
    start = Orientation.new(start: Quaternion.from_euler(0.3, 0.4, 2.9), gain: 2.0)
    o = Enum.reduce(0..1_000, start, &Orientation.update(&2, reading, &1 * 10_000_000))
    {_, _, z} = Quaternion.rotate_vector(o.rotation, {0.0, 0.0, 1.0})
    assert z > 0.9999
  end

  test "learns the gyroscope's offset" do
    reading = ImuReading.new({0.0, 0.0, 9.80665}, {0.05, -0.03, 0.0})

    o =
      Enum.reduce(
        0..6_000,
        Orientation.new(gain: 1.0, drift: 0.3),
        &Orientation.update(&2, reading, &1 * 10_000_000)
      )

    {x, y, _} = o.drift
    assert_in_delta x, 0.05, 1.0e-3
    assert_in_delta y, -0.03, 1.0e-3
  end

  test "tilt and rotation of the synthetic room's sensor match the camera's pose" do
    o =
      Enum.reduce(
        0..1000,
        Orientation.new(start: Scene.state_at(0.0, nil, 0.05).camera.rotation, gain: 0.05),
        fn n, o ->
          Orientation.update(o, Scene.imu_reading(n / 100, 0.05), n * 10_000_000)
        end
      )

    assert Quaternion.angle_between(o.rotation, Scene.state_at(10.0, nil, 0.05).camera.rotation) /
             @degree < 1.0
  end

  test "restarts after a gap from the current reading" do
    level = ImuReading.new({0.0, 0.0, 9.81}, {0.0, 0.0, 0.0})
    tilted = ImuReading.new({9.81, 0.0, 0.0}, {0.0, 0.0, 0.0})

    o =
      Orientation.new()
      |> Orientation.update(level, 0)
      |> Orientation.update(tilted, 2_000_000_001)

    assert Vector3.distance(
             Quaternion.rotate_vector(o.rotation, {1.0, 0.0, 0.0}),
             {0.0, 0.0, 1.0}
           ) <
             1.0e-6
  end

  test "only integrates in free fall or without a usable reading" do
    o =
      Orientation.new() |> Orientation.update(ImuReading.new({0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}), 0)

    o = Orientation.update(o, ImuReading.new({0.0, 0.0, 0.0}, {0.0, 0.0, 1.0}), 100_000_000)
    assert_in_delta o.rotation |> Quaternion.to_euler() |> elem(0), 0.1, 1.0e-9
  end
end
