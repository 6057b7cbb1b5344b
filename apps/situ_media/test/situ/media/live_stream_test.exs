defmodule Situ.Media.LiveStreamTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog
  alias Situ.{AudioBuffer, Image, Time}
  alias Situ.Media.{FFmpeg, FFmpeg.Reader, LiveStream}
  alias Situ.Test.FreePort

  # Each sender has its own color, so an image shows which sender it is from.
  @red [0, 0, 254]
  @blue [254, 0, 0]

  defp start_sender(port, colour, opts \\ []) do
    FFmpeg.start_program(
      System.find_executable("ffmpeg"),
      ~w(-nostdin -v error -re -f lavfi -i color=#{colour}:size=64x48:rate=25) ++
        ~w(-re -f lavfi -i sine=sample_rate=16000 -c:v mpeg2video -g 5 -c:a mp2) ++
        ~w(-output_ts_offset #{opts[:from] || 0} -f mpegts udp://127.0.0.1:#{port}?pkt_size=1316)
    )
  end

  defp start_live(opts) do
    port = FreePort.find_udp()
    test = self()

    {:ok, pipeline} =
      Situ.Pipeline.start(
        fn p ->
          live = LiveStream.open(p, [device: "udp://127.0.0.1:#{port}", name: "Live"] ++ opts)

          for {kind, stream} <- live do
            Situ.each(stream, fn data, message ->
              send(test, {kind, message.originating_time, Situ.Pipeline.now(p), data})
            end)
          end
        end,
        []
      )

    {port, pipeline}
  end

  # Returns the time of the next image with this color, and its arrival time.
  defp await_colour(colour) do
    assert_receive {:video, time, now, %Image{} = image}, 30_000
    {:ok, pixel} = Image.fetch_pixel(image, 8, 8)

    if Enum.zip_with(pixel, colour, &abs(&1 - &2)) |> Enum.all?(&(&1 < 60)),
      do: {time, now},
      else: await_colour(colour)
  end

  # FFmpeg treats the jump from 100 s as an overflow of a 33-bit clock, so its times leap ahead.
  for from <- [50, 100] do
    test "a sender that restarts after #{from} s is detected immediately, and times continue" do
      log =
        capture_log(fn ->
          {port, pipeline} = start_live(reconnect: true)
          # The sender has been running for a while.
          first = start_sender(port, "red", from: unquote(from))
          {last_red, _} = await_colour(@red)
          assert_receive {:audio, _, _, %AudioBuffer{}}, 30_000
          Port.close(first)
          second = start_sender(port, "blue")
          {blue, now} = await_colour(@blue)
          assert blue > last_red
          # The timestamp is the arrival time, not derived from the old sender's clock.
          assert blue <= now and now - blue < Time.s(20)
          {later, now} = await_colour(@blue)
          assert later > blue and later <= now
          # Both streams continue with one clock.
          assert {:ok, sound} = await_audio_after(blue)
          assert abs(sound - later) < Time.s(5)
          await_description(pipeline, "its clock jumped once")
          Port.close(second)
          Situ.Pipeline.stop(pipeline)
        end)

      assert [_, _] = String.split(log, "the sender's clock jumped by")
    end
  end

  defp await_audio_after(time) do
    assert_receive {:audio, sound, _, _}, 30_000
    if sound > time, do: {:ok, sound}, else: await_audio_after(time)
  end

  # `info/1` asks the component for its description, and a later call returns it.
  defp await_description(pipeline, text, tries \\ 500) do
    [%{description: description} | _] = Situ.Pipeline.info(pipeline).nodes
    assert tries > 0
    assert_receive {kind, _, _, _} when kind in [:audio, :video], 30_000

    unless description && description =~ text,
      do: await_description(pipeline, text, tries - 1)
  end

  test "a silent network is detected after the stall timeout, before ffmpeg's own" do
    # ffmpeg would wait forever because nothing arrives at this port after the first second.
    port = FreePort.find_udp()
    url = "udp://127.0.0.1:#{port}"

    {:ok, reader} =
      Reader.start_link(
        args: ["-i", url] ++ ~w(-map 0:v:0 -c:v rawvideo -pix_fmt bgr24),
        name: url,
        stall_timeout: 300
      )

    sender = start_sender(port, "red")
    assert {:ok, _} = Reader.fetch_streams(reader)
    Port.close(sender)
    started = System.monotonic_time(:millisecond)
    assert %{code: :media_stalled} = read_to_error(reader)
    # Waiting for ffmpeg to exit by itself would take 15 s.
    assert System.monotonic_time(:millisecond) - started < 12_000
    Reader.stop_ffmpeg(reader)
  end

  defp read_to_error(reader) do
    case Reader.next_frame(reader) do
      {:ok, _} -> read_to_error(reader)
      {:error, error} -> error
    end
  end
end
