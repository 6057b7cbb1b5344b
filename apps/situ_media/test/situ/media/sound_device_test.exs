defmodule Situ.Media.SoundDeviceTest do
  # Not async: the audio systems are found through environment variables of the whole VM.
  use ExUnit.Case, async: false
  import Situ.Test.Eventually

  import Situ.Media.TestFiles, only: [path: 1]
  import Situ.Media.TestPipelines
  alias Situ.{AudioBuffer, Time}
  alias Situ.Media.{Device, FFmpeg, Microphone, Speaker, Wav, WavFile}

  @moduletag :tmp_dir

  describe "ALSA (its file plugin provides a file as microphone and a file as speaker)" do
    unless File.exists?("/usr/share/alsa/alsa.conf"), do: @describetag(skip: "no ALSA here")

    setup %{tmp_dir: dir} do
      {:ok, sound} = Wav.read(path("cards_001.wav"))
      File.write!(Path.join(dir, "in.raw"), sound.data)
      config = Path.join(dir, "asound.conf")

      File.write!(config, """
      #{File.read!("/usr/share/alsa/alsa.conf")}
      pcm.mic { type file; slave.pcm "null"; file "/dev/null"; infile "#{dir}/in.raw"; format "raw" }
      pcm.spk { type file; slave.pcm "null"; file "#{dir}/out.wav"; format "wav" }
      pcm.!default { type asym; playback.pcm { type plug; slave.pcm "spk" }
                     capture.pcm { type plug; slave { pcm "mic"; rate 16000; channels 1; format S16_LE } } }
      """)

      put_env("ALSA_CONFIG_PATH", config)
      %{sound: sound}
    end

    test "the microphone returns the exact samples", %{sound: sound} do
      %{out: out} = collect_live(&%{out: Microphone.open(&1, device: "alsa:default")}, out: 60)
      {:ok, heard} = out |> Enum.map(&elem(&1, 2)) |> AudioBuffer.concat()
      length = min(byte_size(heard.data), byte_size(sound.data))
      assert length > 30_000
      assert binary_part(heard.data, 0, length) == binary_part(sound.data, 0, length)
    end

    test "the speaker plays all of the exact samples", %{sound: sound, tmp_dir: dir} do
      assert {:ok, _} =
               Situ.Pipeline.run(fn p ->
                 p |> WavFile.open(path("cards_001.wav")) |> Speaker.play(device: "alsa:default")
               end)

      assert Wav.read(Path.join(dir, "out.wav")) == {:ok, sound}
    end

    @tag :capture_log
    test "a missing card is an error" do
      assert {:error, %{code: :unreadable_media}} =
               Situ.Pipeline.run(&Microphone.open(&1, device: "alsa:hw:99,0"))

      assert {:error, %{code: :cannot_write, what: "cannot open the speaker hw:99,0"} = error} =
               Situ.Pipeline.run(fn p ->
                 p |> WavFile.open(path("cards_001.wav")) |> Speaker.play(device: "alsa:hw:99,0")
               end)

      assert error.fix =~ "situ devices speakers"
    end
  end

  describe "PulseAudio (a null sink whose monitor is a microphone)" do
    unless System.find_executable("pulseaudio"), do: @describetag(skip: "no PulseAudio here")

    setup %{tmp_dir: _dir} do
      # The path of a local socket must be short, but the test's folder is not.
      dir = Path.join(System.tmp_dir!(), "situ-pulse-#{System.unique_integer([:positive])}")
      File.mkdir_p!(dir)
      File.chmod!(dir, 0o700)
      on_exit(fn -> File.rm_rf!(dir) end)
      put_env("XDG_RUNTIME_DIR", dir)
      put_env("PULSE_SERVER", "unix:#{dir}/native")

      port =
        FFmpeg.start_program(
          System.find_executable("pulseaudio"),
          ~w(-n --daemonize=no --exit-idle-time=-1 --use-pid-file=no -L) ++
            ["module-native-protocol-unix socket=#{dir}/native auth-anonymous=1"] ++
            ["-L", "module-null-sink sink_name=virt rate=48000"]
        )

      on_exit(fn -> if Port.info(port), do: Port.close(port) end)
      assert eventually(fn -> Device.Pulse.list() != [] end)
      %{port: port}
    end

    test "lists devices and marks the default" do
      assert [%{id: "pulse:virt.monitor", kind: :microphone}] =
               Enum.filter(Device.Pulse.list(), &(&1.kind == :microphone and &1.default?))

      assert [%Device{id: "pulse:virt", kind: :speaker, name: "Null Output" <> _}] =
               Speaker.list_devices() |> pulse()
    end

    test "the microphone hears the speaker at the pace of the clock" do
      got =
        collect_live(
          fn p ->
            p
            |> Microphone.open(device: "simulated:" <> path("cards_001.wav"), name: "Voice")
            |> Speaker.play(device: "pulse:virt")

            %{mic: Microphone.open(p, device: "pulse:virt.monitor")}
          end,
          mic: 150
        )

      samples =
        for {_, _, buffer} <- got.mic, sample <- AudioBuffer.to_samples(buffer), do: abs(sample)

      # As loud as the recording, so the words were played.
      {:ok, original} = Wav.read(path("cards_001.wav"))
      loudest = original |> AudioBuffer.to_samples() |> Enum.map(&abs/1) |> Enum.max()
      assert Enum.max(samples) > loudest / 2

      # In the steady state, 20 ms of audio arrive every 20 ms, soon after their end and never before it.
      steady = Enum.drop(got.mic, 100)
      times = Enum.map(steady, &elem(&1, 0))
      span = List.last(times) - hd(times)
      expected = (length(times) - 1) * Time.ms(20)
      assert_in_delta span, expected, expected * 0.1
      assert Enum.all?(steady, fn {time, now, _} -> now - time < Time.s(10) end)
    end
  end

  defp pulse(devices), do: Enum.filter(devices, &String.starts_with?(&1.id, "pulse:"))

  defp put_env(name, value) do
    before = System.get_env(name)
    System.put_env(name, value)

    on_exit(fn ->
      if before, do: System.put_env(name, before), else: System.delete_env(name)
    end)
  end
end
