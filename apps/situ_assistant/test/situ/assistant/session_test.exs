defmodule Situ.Assistant.SessionTest do
  # A person (espeak-ng) talks to the assistant in a simulated room. The clock moves only when the
  # test moves it, so every run hears exactly the same audio. `Situ.CLI.TalkTest` uses devices.
  use ExUnit.Case, async: true

  alias Situ.Assistant.Session
  alias Situ.{AudioBuffer, AudioFormat, AudioOps, Store}
  alias Situ.Infer.Speech.{Espeak, Moonshine, Utterance}

  @moduletag :tmp_dir
  @moduletag :moonshine
  @moduletag timeout: 240_000

  if System.find_executable("espeak-ng") == nil, do: @moduletag(skip: "not here: espeak-ng")

  @format AudioFormat.pcm(16_000)
  @step 20_000_000
  @step_samples 320
  @sample 62_500
  # The time from the assistant's output through the loudspeaker and the air to the microphone.
  @echo_delay 200_000_000
  # The loudspeaker is next to the microphone.
  @echo_gain {:db, -20}

  @tale "Once upon a time there lived a king who had a garden full of golden apples. " <>
          "Every night a bird came and took one of them away, and the king was sad. " <>
          "So he sent his three sons, one after the other, to watch by the tree until the morning. " <>
          "The first one fell asleep, the second one fell asleep, but the third one stayed awake."

  test "says the time, sets a timer and can be interrupted when called by name", context do
    room = start_room(context.tmp_dir, chat: [url: serve(@tale), model: "small"])

    room = say(room, "Computer, what time is it?")
    {room, %Utterance{text: heard}, _} = await_event(room, :heard)
    assert heard =~ ~r/what time is it/i
    assert {room, "It is noon.", _} = await_event(room, :said)
    assert {room, true, _} = await_event(room, :speaking)
    assert {room, false, _} = await_event(room, :speaking)

    room = say(room, "Computer, set a timer for two seconds.")
    {room, _utterance, _} = await_event(room, :heard)
    assert {room, "I set a timer for two seconds.", set} = await_event(room, :said)
    assert {room, "Your timer of two seconds is over.", rang} = await_event(room, :said)
    assert rang - set >= 2_000_000_000
    assert {room, true, _} = await_event(room, :speaking)
    assert {room, false, _} = await_event(room, :speaking)

    room = say(room, "Computer, tell me a tale.")
    {room, _utterance, _} = await_event(room, :heard)
    await_chat(room)
    assert {room, true, began} = await_event(room, :speaking)
    room = say(room, "Computer, please stop now.")
    assert {room, _words, _} = await_event(room, :stop)
    assert {room, false, ended} = await_event(room, :speaking)
    {:ok, whole} = Espeak.speak(room.voice, @tale)
    assert ended - began < AudioBuffer.duration_ns(whole) - 3_000_000_000

    # The person's sentence ends later than the echo.
    {room, _utterance, _} = await_event(room, :heard)
    assert {:ok, _report} = Situ.Test.stop(room.test)
    check_recording(Path.join(context.tmp_dir, "Assistant.0000"))
  end

  # The recording contains everything, and its speech can be understood.
  defp check_recording(path) do
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

  # `audible` maps the number of a sample to its value at the microphone.
  defp start_room(path, opts) do
    {:ok, voice} = Espeak.load(rate: 150)
    noon = fn _ -> {{2026, 11, 22}, {12, 0, 0}} end
    me = self()
    play = fn sound -> Situ.each(sound, &send(me, {:played, &1, &2.originating_time})) end
    settings = [path: path, assistant: [local_time: noon] ++ opts, watcher: me, output: play]

    test =
      Situ.Test.start([:microphone], fn %{microphone: microphone} ->
        Session.build(microphone.pipeline, [input: fn _ -> microphone end] ++ settings)
        []
      end)

    %{test: test, voice: voice, heard: 0, audible: %{}}
  end

  # The person begins to speak 0.2 s later.
  defp say(room, text) do
    {:ok, sound} = Espeak.speak(room.voice, text)
    make_audible(room, AudioOps.resample!(sound, @format.rate), room.heard + 3_200)
  end

  defp make_audible(room, sound, from) do
    audible =
      sound
      |> AudioBuffer.to_samples()
      |> Enum.with_index(from)
      |> Enum.reduce(room.audible, fn {sample, i}, audible ->
        Map.update(audible, i, sample, &(&1 + sample))
      end)

    %{room | audible: audible}
  end

  # Moves the clock until the assistant reports this event, for at most 10 s.
  defp await_event(room, key, steps \\ 500)
  defp await_event(_room, key, 0), do: flunk("no #{inspect(key)} within 10 s")

  defp await_event(room, key, steps) do
    receive do
      {:talk, ^key, data, time, _creation} -> {room, data, time}
    after
      0 -> room |> step() |> await_event(key, steps - 1)
    end
  end

  # The language model runs outside of the pipeline, so the clock waits for its reply.
  defp await_chat(room) do
    assert_receive {:talk, :chat, @tale, _time, _creation}
    Situ.Test.settle(room.test)
  end

  defp step(room) do
    Situ.Test.advance(room.test, @step)
    to = room.heard + @step_samples
    samples = for i <- room.heard..(to - 1), do: Map.get(room.audible, i, 0)
    buffer = samples |> Enum.map(&limit_sample/1) |> AudioBuffer.from_samples(@format)
    Situ.Test.feed(room.test, :microphone, [{to * @sample, buffer}])
    add_echoes(%{room | heard: to})
  end

  defp limit_sample(sample), do: sample |> max(-32_768) |> min(32_767)

  defp add_echoes(room) do
    receive do
      {:played, sound, time} ->
        begins = AudioBuffer.start_time(sound, time) + @echo_delay
        echo = AudioOps.gain!(sound, @echo_gain)
        room |> make_audible(echo, div(begins, @sample)) |> add_echoes()
    after
      0 -> room
    end
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
end
