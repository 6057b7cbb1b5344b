defmodule Situ.Bench.Speech do
  @moduledoc """
  Speech: the quality and speed of recognition and synthesis, and the response time of an
  assistant.

  * `speech-recognition`: recorded sentences with known words. Prints the word error rate of each
    recognizer in percent, and how many times faster than real time it is.
  * `speech-synthesis`: prints how many times faster than real time each voice is, and the word
    error rate when Moonshine transcribes it.
  * `talk-delay`: runs the assistant of `situ talk` in real time with ten spoken questions from a
    file at scale 1, and measures from the end of speech to the first audio of the response. The
    goal is 700 ms at the 95th percentile.

  Needs the models that `bin/lib/fetch-model` fetches as `moonshine-tiny-en` and `hibari`.
  """
  alias Situ.{AudioBuffer, AudioFormat, AudioOps}
  alias Situ.Infer.Speech.{Espeak, Hibari, Moonshine, PocketSphinx, Utterance}
  alias Situ.Media.Wav

  @fixtures Path.expand("../../apps/situ_infer/test/fixtures", __DIR__)
  @read ~w(sense_and_sensibility_01_austen_64kb-0870 sense_and_sensibility_01_austen_64kb-0880
           sense_and_sensibility_01_austen_64kb-0930)
  @commands ~w(cards_001 cards_002 cards_004 goforward)
  @grammar """
  #JSGF V1.0;
  grammar commands;
  public <command> = go (forward | backward) <number> meters | <card>+;
  <card> = <number> [of <suit>] | (jack | queen | king | ace) of <suit>;
  <suit> = clubs | diamonds | hearts | spades;
  <number> = one | two | three | four | five | six | seven | eight | nine | ten;
  """
  @questions [
    "Computer, what time is it?",
    "Computer, what day is it today?",
    "Computer, set a timer for ninety minutes.",
    "Computer, cancel the timer.",
    "Computer, what is the date?"
  ]

  def tests do
    [
      {"speech-recognition", &recognition/1},
      {"speech-synthesis", &synthesis/1},
      {"talk-delay", &delay/1}
    ]
  end

  defp recognition(_scale) do
    {:ok, moonshine} = Moonshine.load()
    {:ok, sphinx} = PocketSphinx.load(grammar: @grammar)

    recognized("moonshine_read", Moonshine, moonshine, @read) ++
      recognized("moonshine_commands", Moonshine, moonshine, @commands) ++
      recognized("pocketsphinx_commands", PocketSphinx, sphinx, @commands)
  end

  defp recognized(metric, module, model, files) do
    {:ok, truth} =
      @fixtures |> Path.join("transcripts.json") |> File.read!() |> Situ.JSON.decode()

    sounds = for file <- files, do: Wav.read(Path.join(@fixtures, file <> ".wav")) |> elem(1)

    {heard, spent} =
      timed(fn ->
        for sound <- sounds do
          {:ok, %{text: text}} = module.transcribe(model, sound)
          text
        end
      end)

    said = for file <- files, do: truth[file <> ".wav"]["text"]
    rate(metric, said, heard) ++ speed(metric, sounds, spent)
  end

  defp synthesis(scale) do
    {:ok, moonshine} = Moonshine.load()
    said = for i <- 1..max(round(10 * scale), 1), do: sentence(i)

    for {name, module, voice} <- voices(), reduce: [] do
      metrics ->
        {sounds, spent} =
          timed(fn ->
            for text <- said do
              {:ok, sound} = module.speak(voice, text)
              sound
            end
          end)

        heard =
          for sound <- sounds do
            {:ok, %{text: text}} = Moonshine.transcribe(moonshine, sound)
            text
          end

        metrics ++ rate(name, said, heard) ++ speed(name, sounds, spent)
    end
  end

  defp voices do
    {:ok, espeak} = Espeak.load()
    {:ok, hibari} = Hibari.load()
    [{"espeak", Espeak, espeak}, {"hibari", Hibari, hibari}]
  end

  defp sentence(i) do
    Enum.at(
      [
        "The train to the city leaves at ten in the morning.",
        "Please open the window, it is warm in this room.",
        "We have walked along the river for two hours.",
        "She bought bread, butter and a bottle of milk.",
        "The children play in the garden behind the house."
      ],
      rem(i, 5)
    )
  end

  defp delay(scale) do
    count = max(round(10 * scale), 2)
    folder = Path.join(System.tmp_dir!(), "situ-bench-talk-#{System.unique_integer([:positive])}")
    File.mkdir_p!(folder)

    try do
      file = Path.join(folder, "questions.wav")
      :ok = Wav.write(file, questions(count))
      before = Situ.Bench.cpu_us()
      delays = talk(file, folder)
      spent = (Situ.Bench.cpu_us() - before) / 1_000

      if length(delays) < count,
        do: raise("#{length(delays)} of #{count} questions were answered")

      [
        {"talk_delay_least", hd(delays), "ms"},
        {"talk_delay_p50", at(delays, 0.5), "ms"},
        {"talk_delay_p95", at(delays, 0.95), "ms"},
        {"talk_delay_max", List.last(delays), "ms"},
        {"talk_cpu", spent / count, "ms of CPU a question, all it does included"}
      ]
    after
      File.rm_rf!(folder)
    end
  end

  # Two seconds at the start, and after each question the duration of the response.
  defp questions(count) do
    {:ok, voice} = Espeak.load(rate: 150)
    pause = AudioBuffer.build_silence(AudioFormat.pcm(16_000), 4 * 16_000)

    parts =
      for i <- 0..(count - 1) do
        {:ok, sound} = Espeak.speak(voice, Enum.at(@questions, rem(i, length(@questions))))
        [AudioOps.resample!(AudioOps.reformat!(sound, channels: 1, sample: :s16), 16_000), pause]
      end

    {:ok, whole} = AudioBuffer.concat([pause | List.flatten(parts)])
    whole
  end

  defp talk(file, folder) do
    settings = [
      input: file,
      output: nil,
      path: folder,
      assistant: [local_time: fn _ -> {{2026, 11, 22}, {11, 14, 0}} end],
      watcher: self()
    ]

    {:ok, pipeline} =
      Situ.Pipeline.start(Situ.Assistant.Session, [{:pipeline, [replay: [speed: 1.0]]} | settings])

    monitor = Process.monitor(pipeline)
    delays = listen(monitor, nil, [])
    {:ok, _} = Situ.Pipeline.await(pipeline)
    IO.puts(:stderr, "  " <> Enum.map_join(Enum.reverse(delays), " ", &"#{round(&1)}") <> " ms")
    Enum.sort(delays)
  end

  defp listen(monitor, said, delays) do
    receive do
      {:talk, :heard, utterance, _time, _clock} ->
        listen(monitor, utterance.to, delays)

      {:talk, :speaking, true, _time, clock} when said != nil ->
        listen(monitor, nil, [(clock - said) / 1.0e6 | delays])

      {:talk, _what, _data, _time, _clock} ->
        listen(monitor, said, delays)

      {:DOWN, ^monitor, _, _, _} ->
        delays
    end
  end

  defp at(sorted, q), do: Enum.at(sorted, max(ceil(length(sorted) * q) - 1, 0))

  defp rate(metric, said, heard) do
    [
      {metric <> "_wer", 100 * Utterance.error_rate(Enum.join(said, " "), Enum.join(heard, " ")),
       "%"}
    ]
  end

  defp speed(metric, sounds, spent) do
    spoken = sounds |> Enum.map(&AudioBuffer.duration_ns/1) |> Enum.sum()
    [{metric <> "_speed", spoken / spent, "x real time"}]
  end

  defp timed(fun) do
    started = :erlang.monotonic_time(:nanosecond)
    result = fun.()
    {result, max(:erlang.monotonic_time(:nanosecond) - started, 1)}
  end
end
