defmodule RobotLogTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias RobotLog.{Moments, Silence}
  alias Situ.{Interval, Store, Time, Vector3}

  @bag Application.app_dir(:robot_log, "priv/drive.bag")

  test "every reading above the threshold is in one shock of the log" do
    {printed, %{"Shock" => shocks}} = analyse(["Shock"], shock: 8.0)

    readings =
      for %{data: imu, originating_time: time} <-
            Store.messages(Store.open!(@bag), "/imu/data_raw"),
          abs(Vector3.norm(imu.acceleration) - 9.81) > 8.0,
          do: time

    assert length(readings) == 6

    for time <- readings,
        do: assert(Enum.count(shocks, fn {_, s} -> Interval.contains_point?(s, time) end) == 1)

    assert printed |> String.split("\n") |> Enum.count(&(&1 =~ "shock for")) == length(shocks)
  end

  test "the average speed agrees with the distances between the positions" do
    {_, %{"Speed" => speeds}} = analyse(["Speed"], [])
    assert length(speeds) == 24
    average = Enum.sum(Enum.map(speeds, &elem(&1, 1))) / 24
    assert_in_delta average, 128, 10
  end

  test "two shocks that are close to each other are one" do
    levels = [{0, 0}, {Time.ms(10), 9}, {Time.ms(20), 1}, {Time.ms(30), 9}, {Time.s(1), 0}]
    join = &Situ.via(&1.levels, Moments, above: 5, join: Time.ms(100))

    assert Situ.Test.run([levels: levels], join) ==
             {:ok, [{Time.ms(30), Interval.closed(Time.ms(10), Time.ms(30))}]}
  end

  test "a topic that pauses is silent" do
    messages = for i <- 0..50, i not in 20..29, do: {Time.ms(20 * i), :tick}
    find = &Situ.via(&1.topic, Silence, factor: 3)

    assert Situ.Test.run([topic: messages], find) ==
             {:ok, [{Time.ms(600), Interval.closed(Time.ms(380), Time.ms(600))}]}
  end

  defp analyse(streams, opts) do
    {outputs, printed} =
      with_io(fn ->
        {:ok, outputs} = Situ.Test.run_pipeline(RobotLog, streams, opts)
        outputs
      end)

    {printed, outputs}
  end
end
