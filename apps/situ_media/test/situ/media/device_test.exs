defmodule Situ.Media.DeviceTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog
  import Situ.Media.TestFiles, only: [path: 1]
  import Situ.Media.TestPipelines
  alias Situ.{AudioBuffer, Image, AudioOps, Time}
  alias Situ.Media.{Camera, Device, LiveStream, Microphone, Speaker}
  alias Situ.Test.FreePort

  @moduletag :tmp_dir

  doctest Situ.Media.Device
  doctest Situ.Media.Device.V4L2
  doctest Situ.Media.Device.Pulse
  doctest Situ.Media.Device.Alsa

  @simulated "simulated:" <> path("talk1.mp4")

  defp steps(messages) do
    times = Enum.map(messages, &elem(&1, 0))
    Enum.zip_with(tl(times), times, &(&1 - &2))
  end

  describe "simulated devices" do
    test "a camera and a microphone replay a file in real time and in sync" do
      got =
        collect_live(
          fn p ->
            %{
              camera: Camera.open(p, device: @simulated, size: {64, 32}),
              mic: Microphone.open(p, device: @simulated)
            }
          end,
          camera: 25,
          mic: 50
        )

      assert [{first, _, %Image{width: 64}} | _] = got.camera
      assert [{sound, _, %AudioBuffer{}} | _] = got.mic

      # Both count from the pipeline's start, so the first audio buffer begins at the time of the first image.
      assert sound - first == Time.ms(20)

      # A busy machine may lose an image, as with a real camera. The remaining images are on the file's own grid.
      assert Enum.all?(steps(got.camera), &(rem(&1, Time.ms(40)) == 0))
      assert Enum.all?(steps(got.mic), &(&1 == Time.ms(20)))
      # No image arrives before its time, and one second of video takes about one second.
      assert Enum.all?(got.camera ++ got.mic, fn {time, now, _} -> now >= time end)
      {last, now, _} = List.last(got.mic)
      assert now - first >= last - first
    end

    test "one component emits both streams, and `?once` plays once and completes" do
      short = path("cards_001.wav")

      {{:ok, _}, %{audio: audio}} =
        collect(&LiveStream.open(&1, device: "simulated:#{short}?once", video: false))

      frames = Enum.sum(for {_, b} <- audio, do: AudioBuffer.frame_count(b))
      assert frames == 17_526
    end

    @tag :capture_log
    test "drops messages that a slow pipeline cannot take instead of queueing them" do
      test = self()

      {:ok, pipeline} =
        Situ.Pipeline.start(
          fn p ->
            p
            |> Camera.open(device: @simulated, size: {64, 32}, name: "Camera")
            |> Situ.each(
              fn _, message ->
                send(test, {:took, self(), message.originating_time})
                receive do: (:go_on -> :ok)
              end,
              policy: Situ.Delivery.throttle(1)
            )
          end,
          []
        )

      assert_receive {:took, pid, first}
      # The consumer blocks until 20 images later.
      ref = Process.send_after(self(), :later, 1_000)
      assert_receive :later
      assert is_reference(ref)

      # A few images were in flight; the rest of that second was dropped.
      taken =
        for _ <- 1..6 do
          send(pid, :go_on)
          assert_receive {:took, _, time}
          time
        end

      gaps = Enum.zip_with([first | taken], taken, &(&2 - &1))
      assert Enum.count(gaps, &(&1 > Time.ms(500))) == 1
      assert Enum.find_index(gaps, &(&1 > Time.ms(500))) < 5
      Process.exit(pid, :kill)
      capture_log(fn -> Situ.Pipeline.stop(pipeline) end)
    end

    test "a microphone's gain applies to its audio" do
      short = "simulated:" <> path("cards_001.wav") <> "?once"

      [whole, half] =
        for gain <- [1.0, 0.5] do
          # It plays once, so its end is not a loss that needs a reconnect.
          {{:ok, _}, %{mic: heard}} =
            collect(&%{mic: Microphone.open(&1, device: short, gain: gain)})

          heard |> Enum.map(&elem(&1, 1)) |> Enum.take(20)
        end

      assert half == Enum.map(whole, &AudioOps.gain!(&1, 0.5))
      assert Enum.any?(whole, &(&1 != AudioBuffer.build_silence(&1.format, 320)))
    end

    @tag :capture_log
    test "reopens a lost device and continues its times" do
      short = "simulated:" <> path("cards_001.wav") <> "?once"

      %{audio: audio} =
        collect_live(
          &LiveStream.open(&1,
            device: short,
            video: false,
            reconnect: true,
            audio_format: Situ.AudioFormat.pcm()
          ),
          audio: 70
        )

      # 1.1 s of audio, then a gap of one second until the reconnect, then the same audio again.
      times = Enum.map(audio, &elem(&1, 0))
      assert [gap] = Enum.filter(steps(audio), &(&1 > Time.ms(100)))
      assert gap in Time.ms(900)..Time.s(5)
      assert times == Enum.sort(times)
    end

    @tag :capture_log
    test "a device that fails while running is an error unless it is to be retried", %{
      tmp_dir: dir
    } do
      file = Path.join(dir, "cut.mp4")
      File.write!(file, binary_part(File.read!(path("talk1.mp4")), 0, 200_000))

      assert {:error, %{code: :damaged_media}} =
               Situ.Pipeline.run(
                 &LiveStream.open(&1, device: "simulated:#{file}?once", audio: false)
               )
    end

    test "a missing file is an error" do
      assert {:error, %{code: :no_file}} =
               run_quietly(&Camera.open(&1, device: "simulated:absent.mp4"))
    end
  end

  describe "missing and invalid devices" do
    test "a missing camera is an error when the pipeline starts" do
      assert {:error, %{code: :unreadable_media, what: what, fix: fix}} =
               run_quietly(&Camera.open(&1, device: "v4l2:/dev/video99"))

      assert what == "cannot open the camera /dev/video99"
      assert fix =~ "situ devices cameras"
    end

    test "rejects an unknown driver when the pipeline is built" do
      assert {:error, %{code: :unknown_device}} = run_quietly(&Camera.open(&1, device: "v4l:x"))
    end

    test "a camera is not accepted as a microphone, nor a file as a speaker" do
      assert {:error, %{code: :bad_option}} =
               run_quietly(&Microphone.open(&1, device: "/dev/video0"))

      assert {:error, %{code: :bad_option}} = Speaker.init(device: "simulated:x", latency: 1)
    end

    test "a camera that cannot be configured is an error when it is opened" do
      assert {:error, %{code: code, what: what}} =
               run_quietly(
                 &Camera.open(&1, device: "/dev/video99", controls: [{"brightness", 1}])
               )

      # The code depends on whether v4l2-ctl is installed.
      assert code in [:bad_option, :no_v4l2_ctl]
      assert what =~ "/dev/video99"
      assert Camera.controls("simulated:talk1.mp4") == []
      assert Camera.controls("/dev/video99") == []
    end

    test "a URL cannot read local files" do
      assert {:error, %{code: :bad_option}} =
               run_quietly(&LiveStream.open(&1, device: "file:///etc/passwd"))

      assert {:error, %{code: :unknown_device}} =
               run_quietly(&LiveStream.open(&1, device: "concat:/etc/passwd"))
    end

    test "listing devices never fails" do
      assert is_list(Device.list())
    end

    defp run_quietly(build) do
      test = self()
      capture_log(fn -> send(test, {:result, Situ.Pipeline.run(build)}) end)
      assert_received {:result, result}
      result
    end
  end

  defmodule Blinker do
    @moduledoc false
    # A custom driver: a color from ffmpeg's test sources.
    @behaviour Situ.Media.Device

    @impl true
    def list, do: [%Situ.Media.Device{id: "blinker:red", kind: :camera}]

    @impl true
    def capture(color, :camera, _opts),
      do: {:ok, %{args: ~w(-re -f lavfi -i color=#{color}:size=16x16:rate=50), clock: :arrival}}
  end

  describe "test images and the network" do
    test "a custom driver works like a built-in one" do
      %{out: [{_, _, image} | _]} =
        collect_live(&%{out: Camera.open(&1, device: {Blinker, "red"}, size: nil)}, out: 3)

      assert {:ok, [blue, green, red]} = Image.fetch_pixel(image, 8, 8)
      assert red > 240 and blue < 15 and green < 15
    end

    test "any ffmpeg input can be a camera" do
      device = "lavfi:testsrc=size=64x48:rate=50"
      %{out: out} = collect_live(&%{out: Camera.open(&1, device: device, size: nil)}, out: 20)
      assert [{_, _, %Image{width: 64, height: 48}} | _] = out
      assert Enum.all?(steps(out), &(rem(&1, Time.ms(20)) == 0))
    end

    test "a UDP stream delivers video and audio" do
      port = FreePort.find_udp()

      sender =
        Situ.Media.FFmpeg.start_program(System.find_executable("ffmpeg"), [
          "-nostdin",
          "-v",
          "error",
          "-re",
          "-stream_loop",
          "-1",
          "-i",
          path("talk1.mp4"),
          "-c",
          "copy",
          "-f",
          "mpegts",
          "udp://127.0.0.1:#{port}?pkt_size=1316"
        ])

      got =
        collect_live(
          &LiveStream.open(&1, device: "udp://127.0.0.1:#{port}", size: {64, 32}),
          video: 20,
          audio: 10
        )

      Port.close(sender)
      assert [{_, _, %Image{width: 64, height: 32}} | _] = got.video
      assert [{_, _, %AudioBuffer{format: %{rate: 16_000, channels: 1}}} | _] = got.audio
      # The steps are the sender's, not the network's; MPEG-TS counts in 90 kHz.
      assert Enum.all?(steps(got.video), &(abs(rem(&1 + Time.ms(1), Time.ms(40))) <= Time.ms(2)))
      # The times are near the clock.
      assert Enum.all?(got.video, fn {time, now, _} -> abs(now - time) < Time.s(10) end)
    end
  end
end
