defmodule Situ.CLI.TalkTest do
  # A person (espeak-ng) talks to the assistant over a virtual microphone and hears it over a
  # virtual speaker. Not async, because environment variables of the entire VM select the audio
  # server.
  use ExUnit.Case, async: false
  import Situ.Test.Eventually

  alias Situ.Infer.Speech.{Espeak, Moonshine, Utterance}
  alias Situ.Assistant.Session
  alias Situ.Media.{Device, FFmpeg, Wav}
  alias Situ.{AudioBuffer, Store}

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
    echo()
    {:ok, voice} = Espeak.load(rate: 150)
    %{voice: voice, dir: dir}
  end

  # The loudspeaker is next to the microphone, so its sound comes back at -20 dB.
  defp echo do
    loop = ~w(load-module module-loopback source=spk.monitor sink=mic latency_msec=60)
    {_, 0} = System.cmd("pactl", loop)
    {inputs, 0} = System.cmd("pactl", ~w(list short sink-inputs))
    [id | _] = String.split(inputs)
    {_, 0} = System.cmd("pactl", ["set-sink-input-volume", id, "-20dB"])
  end

  @tale "Once upon a time there lived a king who had a garden full of golden apples. " <>
          "Every night a bird came and took one of them away, and the king was sad. " <>
          "So he sent his three sons, one after the other, to watch by the tree until the morning. " <>
          "The first one fell asleep, the second one fell asleep, but the third one stayed awake."

  test "says the time, sets a timer and can be interrupted when called by name", context do
    url = serve(@tale)
    pipeline = start(context, chat: [url: url, model: "small"])

    say(context, "Computer, what time is it?")
    assert_receive {:talk, :heard, %Utterance{text: heard}, _, _}, 60_000
    assert heard =~ ~r/what time is it/i
    assert_receive {:talk, :said, "It is noon.", _, _}, 60_000
    assert_receive {:talk, :speaking, true, _, _}, 60_000
    assert_receive {:talk, :speaking, false, _, _}, 60_000

    say(context, "Computer, set a timer for two seconds.")
    assert_receive {:talk, :said, "I set a timer for two seconds.", set, _}, 60_000
    assert_receive {:talk, :said, "Your timer of two seconds is over.", rang, _}, 60_000
    assert rang - set >= 2_000_000_000
    silent_after(rang)

    say(context, "Computer, tell me a tale.")
    assert_receive {:talk, :chat, @tale, _, _}, 60_000
    assert_receive {:talk, :speaking, true, began, _}, 60_000
    say(context, "Computer, please stop now.")
    assert_receive {:talk, :stop, _, _, _}, 60_000
    assert_receive {:talk, :speaking, false, ended, _}, 60_000

    assert {:ok, %{result: %{path: path}}} = Situ.Pipeline.stop(pipeline)
    {:ok, whole} = Espeak.speak(context.voice, @tale)
    assert ended - began < AudioBuffer.duration_ns(whole) - 3_000_000_000
    recorded(path)
  end

  # The two may follow each other without a pause.
  defp silent_after(time) do
    assert_receive {:talk, :speaking, false, at, _}, 60_000
    if at <= time, do: silent_after(time)
    receive do: ({:talk, :speaking, true, _, _} -> :ok), after: (0 -> :ok)
    receive do: ({:talk, :speaking, true, _, _} -> :ok), after: (0 -> :ok)
  end

  # The recording contains everything, and its speech can be understood.
  defp recorded(path) do
    {:ok, store} = Store.open(path)
    said = Enum.map(Store.messages(store, "Assistant.Said.Text"), & &1.data)
    assert ["It is noon.", "I set a timer for two seconds." | _] = said
    spoken = for message <- Store.messages(store, "Assistant.Said.Sound"), do: message.data
    {:ok, sound} = spoken |> Enum.take(400) |> AudioBuffer.concat()
    {:ok, moonshine} = Moonshine.load()
    assert {:ok, %{text: text}} = Moonshine.transcribe(moonshine, sound)
    assert Enum.all?(["two", "seconds", "over"], &(&1 in Utterance.normalize_words(text))), text
    assert Enum.any?(Store.messages(store, "Assistant.Interrupted"))
    # The assistant's own voice came back, and none of it counted as speech.
    heard = for message <- Store.messages(store, "Assistant.Heard.Text"), do: message.data
    assert length(heard) == 4, inspect(heard)
    refute Enum.any?(heard, &(&1 =~ ~r/noon|king|garden|golden|over/i)), inspect(heard)
    assert Enum.count(Store.messages(store, "Assistant.Heard.Sound")) > 100
  end

  defp start(context, opts) do
    assistant = [local_time: fn _ -> {{2026, 11, 22}, {12, 0, 0}} end] ++ opts

    settings = [
      input: "pulse:mic.monitor",
      output: "pulse:spk",
      path: context.tmp_dir,
      assistant: assistant,
      watcher: self()
    ]

    {:ok, pipeline} = Situ.Pipeline.start(Session, settings)
    # The models are loaded and the microphone is open.
    assert_receive {:talk, :listening, _, _, _}, 60_000
    pipeline
  end

  defp say(context, text) do
    {:ok, sound} = Espeak.speak(context.voice, text)
    path = Path.join(context.dir, "said.wav")
    :ok = Wav.write(path, sound)
    {_, 0} = System.cmd("paplay", ["-d", "mic", path])
  end

  # A language model that knows one tale.
  defp serve(text) do
    {:ok, listener} =
      :gen_tcp.listen(0, [:binary, active: false, reuseaddr: true, ip: {127, 0, 0, 1}])

    {:ok, port} = :inet.port(listener)
    body = Situ.JSON.encode(%{choices: [%{message: %{content: text}, finish_reason: "stop"}]})

    head =
      "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: #{byte_size(body)}\r\n\r\n"

    spawn_link(fn -> answer(listener, head <> body) end)
    "http://127.0.0.1:#{port}/v1"
  end

  defp answer(listener, response) do
    {:ok, socket} = :gen_tcp.accept(listener)
    {:ok, _} = :gen_tcp.recv(socket, 0)
    :gen_tcp.send(socket, response)
    :gen_tcp.close(socket)
    answer(listener, response)
  end

  defp put_env(name, value) do
    before = System.get_env(name)
    System.put_env(name, value)
    on_exit(fn -> if before, do: System.put_env(name, before), else: System.delete_env(name) end)
  end
end
