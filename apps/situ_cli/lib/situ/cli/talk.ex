defmodule Situ.CLI.Talk do
  @moduledoc "`situ talk`: runs a voice assistant."
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Option, Output, Verb}
  alias Situ.CLI.Talk.Session
  alias Situ.{Error, Pipeline, Studio}

  @impl true
  def verbs do
    [
      %Verb{
        words: ["talk"],
        summary: "talk to an assistant that listens, acts and replies aloud",
        about: """
        Listens to a microphone (or plays an audio file in real time), recognizes sentences that contain its name,
        determines the intent, acts on it and replies aloud; it can be interrupted. It announces time and date and sets
        timers; with --chat, a language model replies to all other questions. Everything is on this machine, except a
        language model at another address. Everything is recorded and shown live in the studio. The language is
        English; the recognizer's model (44 MB) is downloaded on first use.
        """,
        arguments: [],
        options: [
          Option.new(
            :input,
            :string,
            "a microphone of `situ devices`, an audio file, or \"page\": the studio's page /sensor?name=talk",
            value: "DEVICE|FILE",
            default: "pulse:default"
          ),
          Option.new(
            :output,
            :string,
            "a speaker of `situ devices`, or none (default: pulse:default; for files: none)",
            value: "DEVICE"
          ),
          Option.new(:wake, :string, "its name; with \"\" it responds to everything",
            default: "computer"
          ),
          Option.new(
            :voice,
            :string,
            "a voice of `espeak-ng --voices`, or hibari, a natural one (8 MB, downloaded on first use)",
            default: "en-us"
          ),
          Option.new(
            :grammar,
            :path,
            "a JSGF grammar with more sentences to understand; their intents are recorded"
          ),
          Option.new(
            :chat,
            :string,
            "ask the language model at this address if no rule applies",
            value: "URL"
          ),
          Option.new(:model, :string, "the language model", default: "llama3.2"),
          Option.new(:key, :string, "the environment variable that contains the model's API key",
            value: "VARIABLE"
          ),
          Option.new(:out, :path, "the folder of the recording", default: "recordings"),
          Option.new(
            :seconds,
            :float,
            "stop after this many seconds (default: when Enter is pressed, or the file ends)"
          ),
          Option.new(:studio, :flag, "do not serve the studio", negated?: true),
          Option.new(:port, :integer, "the studio's port; 0 selects a free one", default: 4040)
        ],
        examples: ["situ talk", "situ talk --chat http://127.0.0.1:11434/v1 --model llama3.2"],
        run: fn _arguments, opts -> talk(opts) end
      }
    ]
  end

  defp talk(opts) do
    for app <- [:situ_infer, :situ_studio], do: {:ok, _} = Application.ensure_all_started(app)

    settings = [
      input: opts[:input],
      output: output(opts),
      path: opts[:out],
      assistant: assistant(opts),
      watcher: self()
    ]

    with :ok <- input(opts[:input]),
         :ok <- served(opts),
         {:ok, pipeline} <-
           Pipeline.start(Session, [
             {:pipeline, [name: "Assistant", replay: [speed: 1.0]]} | settings
           ]) do
      studio = if opts[:studio], do: studio(opts)
      stopper = stopper(pipeline, opts)
      monitor = Process.monitor(pipeline)
      counts = listen(monitor, opts, %{heard: 0, delays: [], last: nil, speaking: false})
      Process.exit(stopper, :kill)
      result = Pipeline.await(pipeline)
      if studio, do: Process.exit(studio, :shutdown)
      done(result, counts, opts)
    else
      {:error, error} -> raise error
    end
  end

  defp output(opts) do
    case opts[:output] do
      "none" -> nil
      nil -> output_beside(opts[:input])
      device -> device
    end
  end

  defp served(opts) do
    if "page" in [opts[:input], opts[:output]] and not opts[:studio],
      do: {:error, Error.new(:usage, "a page needs the studio", fix: "omit --no-studio")},
      else: :ok
  end

  defp output_beside("page"), do: "page"
  defp output_beside(input), do: if(File.regular?(input), do: nil, else: "pulse:default")

  # A device is named DRIVER:ADDRESS.
  defp input("page"), do: :ok

  defp input(input) do
    if File.regular?(input) or match?({:ok, _}, Situ.Media.Device.parse(input)),
      do: :ok,
      else:
        {:error,
         Error.new(:no_input, "there is neither a file nor a microphone #{inspect(input)}",
           fix: "run `situ devices microphones` to list the microphones"
         )}
  end

  defp assistant(opts) do
    wake = if opts[:wake] == "", do: nil, else: opts[:wake]
    chat = opts[:chat] && [url: opts[:chat], model: opts[:model], key: opts[:key]]

    [
      wake: wake,
      local_time: fn _ -> :calendar.local_time() end,
      grammar: opts[:grammar],
      chat: chat,
      synthesizer: voice(opts[:voice])
    ]
  end

  defp voice("hibari"), do: [synthesizer: Situ.Infer.Speech.Hibari]
  defp voice(name), do: [synthesizer_options: [voice: name]]

  defp studio(opts) do
    Process.flag(:trap_exit, true)

    case Studio.start_link(path: opts[:out], port: opts[:port]) do
      {:ok, studio} ->
        unless opts[:json], do: Output.puts("The studio shows it at #{Studio.url(studio)}")
        if opts[:input] == "page", do: Output.puts("Talk to the page #{page(studio)}")
        studio

      {:error, error} ->
        Output.warn("situ talk: #{Exception.message(error)}")
        nil
    end
  end

  defp stopper(pipeline, opts) do
    spawn(fn ->
      if opts[:seconds], do: Process.sleep(round(opts[:seconds] * 1000)), else: enter(opts)
      Pipeline.stop(pipeline)
    end)
  end

  # The URL may contain the token that the browser must send.
  defp page(studio) do
    url = URI.parse(Studio.url(studio))
    query = URI.encode_query(Map.put(URI.decode_query(url.query || ""), "name", "talk"))
    URI.to_string(%{url | path: "/sensor", query: query})
  end

  # Without a terminal nobody can press Enter, so the end of the file or a signal stops the assistant.
  defp enter(opts) do
    unless opts[:json] or File.regular?(opts[:input]),
      do: Output.puts("Listening. Press Enter to stop.")

    if File.regular?(opts[:input]) or IO.gets("") == :eof, do: Process.sleep(:infinity)
  end

  defp listen(monitor, opts, counts) do
    receive do
      {:talk, what, data, time, clock} ->
        unless what == :stop and not counts.speaking, do: show(what, data, time, opts)
        listen(monitor, opts, count(what, data, time, clock, counts))

      {:DOWN, ^monitor, _, _, _} ->
        counts
    end
  end

  defp count(:heard, utterance, _time, _clock, counts),
    do: %{counts | heard: counts.heard + 1, last: utterance.to}

  defp count(:speaking, true, _time, clock, %{last: last} = counts) when last != nil,
    do: %{counts | delays: [clock - last | counts.delays], last: nil, speaking: true}

  defp count(:speaking, speaking?, _time, _clock, counts), do: %{counts | speaking: speaking?}
  defp count(_what, _data, _time, _clock, counts), do: counts

  defp show(what, data, time, opts) do
    line = line(what, data)

    cond do
      line == nil -> :ok
      opts[:json] -> Output.json(%{what: what, text: elem(line, 1), time: time})
      true -> Output.puts(String.pad_trailing(elem(line, 0), 12) <> Output.name(elem(line, 1)))
    end
  end

  defp line(:heard, utterance), do: {"you", utterance.text}
  defp line(:said, text), do: {"assistant", text}
  defp line(:chat, text), do: {"assistant", text}
  defp line(:stop, text), do: {"(interrupts)", text}

  defp line(:intent, intent),
    do: if(Situ.Intent.name(intent), do: {"(wants)", Situ.Intent.format(intent)})

  defp line(_what, _data), do: nil

  defp done({:ok, %{result: %{path: path}}}, counts, opts) do
    delays = Enum.sort(counts.delays)
    worst = List.last(delays)
    ms = &(&1 && div(&1, 1_000_000))

    if opts[:json] do
      Output.json(%{
        recording: path,
        heard: counts.heard,
        answers: length(delays),
        median_ms: ms.(quantile(delays, 0.5)),
        p95_ms: ms.(quantile(delays, 0.95)),
        worst_ms: ms.(worst)
      })
    else
      Output.puts(
        "Recorded in #{path}: #{Output.number(counts.heard, "utterance")}, #{Output.number(length(delays), "answer")}"
      )

      if worst,
        do:
          Output.puts(
            "From the end of speech to the first sound: #{ms.(quantile(delays, 0.5))} ms, #{ms.(worst)} ms at most"
          )
    end

    0
  end

  defp done({:error, error}, _counts, _opts), do: raise(error)

  defp quantile([], _q), do: nil
  defp quantile(delays, q), do: Enum.at(delays, max(ceil(length(delays) * q) - 1, 0))
end
