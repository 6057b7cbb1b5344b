defmodule Situ.CLI.Talk do
  @moduledoc false
  # `situ talk`: runs a voice assistant.
  @behaviour Situ.CLI.Verb

  alias Situ.Assistant.Session
  alias Situ.CLI.{Option, Output, Verb}
  alias Situ.{Error, Pipeline, Studio}
  alias Situ.Studio.Sensor

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
        run: fn _arguments, opts -> run_assistant(opts) end
      }
    ]
  end

  defp run_assistant(opts) do
    for app <- [:situ_assistant, :situ_studio], do: {:ok, _} = Application.ensure_all_started(app)

    settings = [
      input: input_source(opts[:input]),
      output: opts |> output_device() |> output_sink(),
      path: opts[:out],
      assistant: assistant_options(opts),
      watcher: self()
    ]

    with :ok <- check_input(opts[:input]),
         :ok <- check_page(opts),
         {:ok, pipeline} <-
           Pipeline.start(Session, [
             {:pipeline, [name: "Assistant", replay: [speed: 1.0]]} | settings
           ]) do
      studio = if opts[:studio], do: start_studio(opts)
      stopper = start_stopper(pipeline, opts)
      monitor = Process.monitor(pipeline)
      counts = receive_events(monitor, opts, %{heard: 0, delays: [], last: nil, speaking: false})
      Process.exit(stopper, :kill)
      result = Pipeline.await(pipeline)
      if studio, do: Process.exit(studio, :shutdown)
      report_result(result, counts, opts)
    else
      {:error, error} -> raise error
    end
  end

  defp output_device(opts) do
    case opts[:output] do
      "none" -> nil
      nil -> default_output(opts[:input])
      device -> device
    end
  end

  defp check_page(opts) do
    if "page" in [opts[:input], opts[:output]] and not opts[:studio],
      do: {:error, Error.new(:usage, "a page needs the studio", fix: "omit --no-studio")},
      else: :ok
  end

  # The functions of the studio's page, which the assistant does not know.
  defp input_source("page") do
    fn pipeline ->
      audio = Sensor.open(pipeline, page: "talk").audio
      Situ.AudioStream.resample(audio, 16_000)
    end
  end

  defp input_source(device), do: device

  defp output_sink("page"), do: &Sensor.Speaker.play(&1, page: "talk")
  defp output_sink(device), do: device

  defp default_output("page"), do: "page"
  defp default_output(input), do: if(File.regular?(input), do: nil, else: "pulse:default")

  # A device is named DRIVER:ADDRESS.
  defp check_input("page"), do: :ok

  defp check_input(input) do
    if File.regular?(input) or match?({:ok, _}, Situ.Media.Device.parse_name(input)),
      do: :ok,
      else:
        {:error,
         Error.new(:no_input, "there is neither a file nor a microphone #{inspect(input)}",
           fix: "run `situ devices microphones` to list the microphones"
         )}
  end

  defp assistant_options(opts) do
    wake = if opts[:wake] == "", do: nil, else: opts[:wake]
    chat = opts[:chat] && [url: opts[:chat], model: opts[:model], key: opts[:key]]

    [
      wake: wake,
      local_time: fn _ -> :calendar.local_time() end,
      grammar: opts[:grammar],
      chat: chat,
      synthesizer: voice_options(opts[:voice])
    ]
  end

  defp voice_options("hibari"), do: [synthesizer: Situ.Infer.Speech.Hibari]
  defp voice_options(name), do: [synthesizer_options: [voice: name]]

  defp start_studio(opts) do
    Process.flag(:trap_exit, true)

    case Studio.start_link(path: opts[:out], port: opts[:port]) do
      {:ok, studio} ->
        unless opts[:json], do: Output.puts("The studio shows it at #{Studio.url(studio)}")
        if opts[:input] == "page", do: Output.puts("Talk to the page #{sensor_page(studio)}")
        studio

      {:error, error} ->
        Output.warn("situ talk: #{Exception.message(error)}")
        nil
    end
  end

  defp start_stopper(pipeline, opts) do
    spawn(fn ->
      if opts[:seconds],
        do: Process.sleep(round(opts[:seconds] * 1000)),
        else: wait_for_enter(opts)

      Pipeline.stop(pipeline)
    end)
  end

  # The URL may contain the token that the browser must send.
  defp sensor_page(studio) do
    url = URI.parse(Studio.url(studio))
    query = URI.encode_query(Map.put(URI.decode_query(url.query || ""), "name", "talk"))
    URI.to_string(%{url | path: "/sensor", query: query})
  end

  # Without a terminal nobody can press Enter, so the end of the file or a signal stops the assistant.
  defp wait_for_enter(opts) do
    unless opts[:json] or File.regular?(opts[:input]),
      do: Output.puts("Listening. Press Enter to stop.")

    if File.regular?(opts[:input]) or IO.gets("") == :eof, do: Process.sleep(:infinity)
  end

  defp receive_events(monitor, opts, counts) do
    receive do
      {:talk, what, data, time, clock} ->
        unless what == :stop and not counts.speaking, do: show_event(what, data, time, opts)
        receive_events(monitor, opts, update_counts(what, data, time, clock, counts))

      {:DOWN, ^monitor, _, _, _} ->
        counts
    end
  end

  defp update_counts(:heard, utterance, _time, _clock, counts),
    do: %{counts | heard: counts.heard + 1, last: utterance.to}

  defp update_counts(:speaking, true, _time, clock, %{last: last} = counts) when last != nil,
    do: %{counts | delays: [clock - last | counts.delays], last: nil, speaking: true}

  defp update_counts(:speaking, speaking?, _time, _clock, counts),
    do: %{counts | speaking: speaking?}

  defp update_counts(_what, _data, _time, _clock, counts), do: counts

  defp show_event(what, data, time, opts) do
    line = event_line(what, data)

    cond do
      line == nil ->
        :ok

      opts[:json] ->
        Output.print_json(%{what: what, text: elem(line, 1), time: time})

      true ->
        Output.puts(String.pad_trailing(elem(line, 0), 12) <> Output.format_name(elem(line, 1)))
    end
  end

  defp event_line(:heard, utterance), do: {"you", utterance.text}
  defp event_line(:said, text), do: {"assistant", text}
  defp event_line(:chat, text), do: {"assistant", text}
  defp event_line(:stop, text), do: {"(interrupts)", text}

  defp event_line(:intent, intent),
    do: if(Situ.Intent.name(intent), do: {"(wants)", Situ.Intent.format(intent)})

  defp event_line(_what, _data), do: nil

  defp report_result({:ok, %{result: %{path: path}}}, counts, opts) do
    delays = Enum.sort(counts.delays)
    worst = List.last(delays)
    ms = &(&1 && div(&1, 1_000_000))

    if opts[:json] do
      Output.print_json(%{
        recording: path,
        heard: counts.heard,
        answers: length(delays),
        median_ms: ms.(quantile(delays, 0.5)),
        p95_ms: ms.(quantile(delays, 0.95)),
        worst_ms: ms.(worst)
      })
    else
      Output.puts(
        "Recorded in #{path}: #{Output.format_count(counts.heard, "utterance")}, " <>
          "#{Output.format_count(length(delays), "answer")}"
      )

      if worst,
        do:
          Output.puts(
            "From the end of speech to the first sound: #{ms.(quantile(delays, 0.5))} ms, #{ms.(worst)} ms at most"
          )
    end

    0
  end

  defp report_result({:error, error}, _counts, _opts), do: raise(error)

  defp quantile([], _q), do: nil
  defp quantile(delays, q), do: Enum.at(delays, max(ceil(length(delays) * q) - 1, 0))
end
