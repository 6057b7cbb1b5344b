defmodule Situ.Media.CaptureTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog
  alias Situ.{Image, Time}
  alias Situ.Media.{Capture, FFmpeg.Reader}

  @opts [
    format: :gray8,
    size: nil,
    rate: nil,
    audio_format: nil,
    audio_buffer: Time.ms(20),
    buffer: 1_000,
    stall_timeout: Time.s(2)
  ]
  @streams %{
    0 => %{id: 0, class: :video, width: 2, height: 1, time_base: {1, 1000}},
    1 => %{id: 1, class: :audio, rate: 8000, channels: 1, time_base: {1, 8000}}
  }

  # A capture whose reader is this process, so the test decides which frames arrive and when.
  defp capture(opts) do
    outputs = %{video: :video, audio: :audio}
    {:ok, capture} = Capture.new("udp://127.0.0.1:9", outputs, @opts ++ opts)
    capture = %{capture | reader: self(), clock: :arrival, times: Capture.Clock.new(nil)}
    {actions, capture} = arrive(capture, {:streams, @streams}, 0)
    assert [{:timer, {:watch, _}, _}] = actions
    capture
  end

  defp arrive(capture, result, ms),
    do: Capture.handle_info(capture, {Reader, self(), result}, context(ms))

  defp context(ms), do: %{now: Time.ms(ms), start_time: 0}

  defp picture(ms), do: {:frame, %{stream: 0, time: Time.ms(ms), ticks: ms, data: <<1, 2>>}}

  defp sound(ms),
    do: {:frame, %{stream: 1, time: Time.ms(ms), ticks: ms * 8, data: <<0::320*8>>}}

  defp feed(capture, frames) do
    Enum.reduce(frames, capture, fn {frame, at}, capture ->
      {[], capture} = arrive(capture, frame, at)
      capture
    end)
  end

  defp look(capture, ms),
    do: Capture.handle_info(capture, {:timer, {:watch, self()}}, context(ms))

  test "reports stalled video once while the audio continues" do
    both = for t <- 0..40, frame <- [picture(40 * t), sound(40 * t)], do: {frame, 40 * t}
    capture = capture(reconnect: true) |> feed(both)
    only_sound = for t <- 41..120, do: {sound(40 * t), 40 * t}
    capture = feed(capture, only_sound)

    log =
      capture_log(fn ->
        {[{:timer, {:watch, _}, _}], capture} = look(capture, 4_801)
        assert Capture.describe_status(capture) =~ "running, 0 dropped, no video"
        # The stall is not reported again, and the device is still open.
        {[_], capture} = look(capture, 4_900)
        send(self(), capture)
      end)

    assert [_, _] = String.split(log, "no video for 2.00 s")
    assert_received %Capture{} = capture
    # Video frames that arrive again end the stall.
    {[], capture} = arrive(capture, picture(4_950), 4_950)
    {[_], capture} = look(capture, 4_960)
    refute Capture.describe_status(capture) =~ "no video"
    {messages, _} = Capture.handle_demand(capture, 1_000, context(5_000))
    assert {:video, _, %Image{}} = List.keyfind(messages, :video, 0)
    assert Enum.count(messages, &(elem(&1, 0) == :audio)) > 50
  end

  test "reopens the stream when frames repeat one time because ffmpeg lost the clock" do
    test = self()
    reader = spawn_link(fn -> receive do: (:stop -> send(test, :stopped)) end)
    capture = %{capture(reconnect: true) | reader: reader}

    frames =
      for t <- 0..100, frame <- [picture(1_000 + div(t, 50)), sound(40 * t)], do: {frame, 40 * t}

    capture =
      Enum.reduce(frames, capture, fn {frame, at}, capture ->
        elem(Capture.handle_info(capture, {Reader, reader, frame}, context(at)), 1)
      end)

    log =
      capture_log(fn ->
        {actions, capture} =
          Capture.handle_info(capture, {:timer, {:watch, reader}}, context(4_001))

        assert [{:timer, :reconnect, _}] = actions
        assert capture.reader == nil
      end)

    assert log =~ "is lost, trying again every second: the times of its video do not move"
    refute Process.alive?(reader)
  end

  test "reports a clock jump with its stream, and times continue from the arrival" do
    before = for t <- 0..20, frame <- [picture(40 * t), sound(40 * t)], do: {frame, 40 * t}
    capture = capture(reconnect: false) |> feed(before)
    step = 10_000_000_000

    again =
      for t <- 0..20,
          frame <- [picture(step + 10 * t), sound(step + 10 * t)],
          do: {frame, 9_000 + 40 * t}

    log = capture_log(fn -> send(self(), feed(capture, again)) end)
    assert_received %Capture{} = capture
    assert [_, _] = String.split(log, "the sender's clock jumped by -800 ms (video)")
    assert Capture.describe_status(capture) =~ "its clock jumped once"
    {messages, _} = Capture.handle_demand(capture, 1_000, context(10_000))
    times = for {:video, time, _} <- messages, do: time
    assert times == Enum.sort(Enum.uniq(times))
    assert List.last(times) in Time.ms(9_000)..Time.ms(9_800)
  end
end
