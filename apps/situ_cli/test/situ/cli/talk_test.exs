defmodule Situ.CLI.TalkTest do
  # A person (espeak-ng) talks to the assistant over a virtual microphone and hears it over a
  # virtual speaker. The words that are recognized depend on the timing of the audio server, so
  # `Situ.Assistant.SessionTest` checks conversations, without devices. Not async, because
  # environment variables of the entire VM select the audio server.
  use ExUnit.Case, async: false
  import Situ.Test.Eventually

  alias Situ.Assistant.Session
  alias Situ.{AudioOps, Pipeline, Store}
  alias Situ.Infer.Speech.Espeak
  alias Situ.Media.{Device, FFmpeg, Microphone, Wav}

  @moduletag :tmp_dir
  @moduletag :moonshine
  @moduletag timeout: 240_000

  missing = Enum.reject(~w(pulseaudio paplay espeak-ng), &System.find_executable/1)
  if missing != [], do: @moduletag(skip: "not here: " <> Enum.join(missing, ", "))

  setup do
    # The address of a local socket must be short, and the path of the test's folder is too long.
    dir = Path.join(System.tmp_dir!(), "situ-talk-#{System.unique_integer([:positive])}")
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
          ["-L", "module-null-sink sink_name=mic rate=16000 channels=1"] ++
          ["-L", "module-null-sink sink_name=spk rate=16000 channels=1"]
      )

    on_exit(fn -> if Port.info(port), do: Port.close(port) end)
    assert eventually(fn -> length(Device.Pulse.list()) >= 4 end)
    %{dir: dir}
  end

  test "listens to a microphone and replies through a speaker", context do
    me = self()

    {:ok, listener} =
      Pipeline.start(fn p ->
        p
        |> Microphone.open(device: "pulse:spk.monitor")
        |> Situ.each(&send(me, {:level, AudioOps.level!(&1).rms_db}))
      end)

    # Without a name, the assistant replies to every sentence.
    settings = [
      input: "pulse:mic.monitor",
      output: "pulse:spk",
      path: context.tmp_dir,
      assistant: [wake: nil],
      watcher: me
    ]

    {:ok, talk} = Pipeline.start(Session, settings)
    # The models are loaded and the microphone is open.
    assert_receive {:talk, :listening, _, _, _}, 60_000
    assert_receive {:level, _}, 60_000
    say(context, "What time is it?")
    assert_receive {:talk, :said, _reply, _, _}, 60_000
    assert_receive {:level, level} when level > -50, 60_000
    assert {:ok, %{result: %{path: path}}} = Pipeline.stop(talk)
    Pipeline.stop(listener)

    {:ok, store} = Store.open(path)

    for name <- ~w(Heard.Sound Heard.Text Said.Text Said.Sound),
        do: assert(Enum.any?(Store.messages(store, "Assistant." <> name)), name)
  end

  defp say(context, text) do
    {:ok, voice} = Espeak.load(rate: 150)
    {:ok, sound} = Espeak.speak(voice, text)
    path = Path.join(context.dir, "said.wav")
    :ok = Wav.write(path, sound)
    {_, 0} = System.cmd("paplay", ["-d", "mic", path])
  end

  defp put_env(name, value) do
    before = System.get_env(name)
    System.put_env(name, value)
    on_exit(fn -> if before, do: System.put_env(name, before), else: System.delete_env(name) end)
  end
end
