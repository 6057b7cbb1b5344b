defmodule Situ.Examples.Demo do
  @usage """
  Usage: bin/demo [--input FILE|camera] [--truth FILE.json] [--headless] [--json] [--realtime]

  Detects who is speaking in a clip from audio and lips, records everything, prints who spoke when, and then serves the
  studio on the recording.

    --input FILE     a media file (default: the clip included with Situ); "camera" for the first camera and the
                     default microphone; or any other device name, such as "simulated:talk1.mp4?once"
    --truth FILE     the ground truth of the clip: prints the score
    --out FOLDER     folder for the recording (default: "recordings")
    --realtime       run at the speed of the clip instead of as fast as possible
    --seconds N      stop after N seconds (for cameras; default: until Enter is pressed)
    --headless       do not serve the studio afterwards
    --json           print one JSON object and nothing else
    --transcript     recognize speech (English), print who said what, and write a WebVTT file next to the recording
    --profile        print where the time went, component by component
    --port N         port of the studio (default 4040; 0 picks a free port)
    --no-open        do not open a browser
    --cluster        run on three nodes and kill a node midway (--cluster --help)
    --dataset        run a study instead: clips as a dataset, annotated, exported, compared (--dataset --help)
    --experiment     tune the detection over 15 sessions (--experiment --help)
    --scene          record a 3D room instead, with bodies, detections and speech (--scene --help)

  Exit status: 0 success, 1 failure, 2 wrong usage.
  """
  @moduledoc """
  The `bin/demo` command: runs `Situ.Examples.MultimodalVoiceActivity` on a clip or a camera and prints a table and a
  score.

  ```text
  #{@usage}
  ```
  """
  alias Situ.Error

  alias Situ.Examples.Demo.{
    ClusterCommand,
    CommandLine,
    ExperimentCommand,
    Options,
    Profile,
    RecordingSummary,
    Score,
    Table,
    Transcript,
    GroundTruth
  }

  alias Situ.Examples.MultimodalVoiceActivity
  alias Situ.Infer.LipSync

  @doc "Runs the demo and ends the VM with its exit status."
  @spec main([String.t()]) :: no_return()
  def main(argv), do: argv |> run() |> System.halt()

  @doc "Runs the demo and returns the exit status."
  @spec run([String.t()]) :: 0 | 1 | 2
  def run(argv) do
    cond do
      "--experiment" in argv -> ExperimentCommand.run(argv)
      "--dataset" in argv -> Situ.Examples.Study.run(argv)
      "--scene" in argv -> Situ.Examples.Demo.SceneCommand.run(argv)
      "--cluster" in argv -> ClusterCommand.run(argv, &record_clip/1)
      true -> run_talk_demo(argv)
    end
  end

  defp run_talk_demo(argv) do
    case Options.parse(argv) do
      {:ok, opts} -> record_and_show(opts)
      :help -> CommandLine.print_usage(@usage)
      {:error, text} -> CommandLine.print_usage_error(text, "bin/demo")
    end
  end

  @doc """
  Runs the pipeline with `opts`. Returns the pipeline's report and the seconds the run took; `result.path` of the report
  is the path of the recording.

  Options: `input:`, `out:`, `realtime:`, `seconds:`, `sound_shift:`.
  """
  @spec record_clip(keyword()) ::
          {:ok, Situ.Pipeline.Report.t(), wall_s :: float()} | {:error, Error.t()}
  def record_clip(opts) do
    {:ok, _} = Application.ensure_all_started(:situ_examples)

    build = [
      input: opts[:input],
      path: opts[:out],
      policy: opts[:policy],
      transcript: opts[:transcript],
      sound_shift: opts[:sound_shift]
    ]

    started = System.monotonic_time()

    with {:ok, report} <- run_pipeline(build, opts) do
      spent = System.monotonic_time() - started

      {:ok, report, System.convert_time_unit(spent, :native, :microsecond) / 1.0e6}
    end
  end

  defp run_pipeline(build, opts) do
    if opts[:live] do
      record_live(build, opts)
    else
      speed = if opts[:realtime], do: 1.0, else: :max
      settings = [name: "Talk", replay: [speed: speed]]
      Situ.Pipeline.run(MultimodalVoiceActivity, [{:pipeline, settings} | build])
    end
  end

  # A camera never ends, so a time limit or a person must stop it. A simulated camera that plays once ends by itself.
  defp record_live(build, opts) do
    with {:ok, p} <-
           Situ.Pipeline.start(MultimodalVoiceActivity, [{:pipeline, [name: "Talk"]} | build]) do
      stopper = Task.async(fn -> wait_for_end(p, opts[:seconds]) end)
      result = Situ.Pipeline.await(p)
      Task.shutdown(stopper, :brutal_kill)
      result
    end
  end

  defp wait_for_end(p, nil) do
    IO.puts(:stderr, "Watching and listening. Press Enter to stop.")

    # Without a terminal nobody can press Enter, so the demo runs until it is stopped from outside.
    if IO.gets("") == :eof, do: Process.sleep(:infinity)
    Situ.Pipeline.stop(p)
  end

  defp wait_for_end(p, seconds) do
    Process.sleep(round(seconds * 1000))
    Situ.Pipeline.stop(p)
  end

  defp record_and_show(opts) do
    with {:ok, truth} <- read_truth(opts[:truth]) do
      case record_clip(opts) do
        {:ok, report, wall_s} -> show_recording(report, wall_s, truth, opts)
        {:error, error} -> print_partial_results(error, opts)
      end
    else
      {:error, error} -> CommandLine.print_error(error)
    end
  rescue
    error in Error -> CommandLine.print_error(error)
  end

  defp show_recording(%{result: %{path: path}} = report, wall_s, truth, opts) do
    with {:ok, recording} <- RecordingSummary.read(path) do
      if LipSync.out_of_sync?(recording.sync) and can_shift_audio?(opts),
        do: record_synchronized(recording.sync, path, truth, opts),
        else: print_results(recording, report, wall_s, truth, opts)
    else
      {:error, error} -> CommandLine.print_error(error)
    end
  end

  # A camera's input cannot be replayed, and audio that was already shifted is not shifted again.
  defp can_shift_audio?(opts), do: not opts[:live] and opts[:sound_shift] == nil

  defp record_synchronized(sync, path, truth, opts) do
    opts = Keyword.merge(opts, sound_shift: -sync.shift, sync: sync)

    case record_clip(opts) do
      {:ok, report, wall_s} ->
        # The demo made the unsynchronized recording itself, and it is no longer needed.
        Situ.Store.delete(path)
        show_recording(report, wall_s, truth, opts)

      {:error, error} ->
        print_partial_results(error, opts)
    end
  end

  defp print_results(recording, %{result: %{path: path}} = report, wall_s, truth, opts) do
    score = truth && Score.score_decisions(truth, recording.found)
    said = write_transcript(recording, truth, path, opts)
    IO.puts(render_table(opts, recording, score, wall_s, path, said))
    if opts[:profile], do: IO.puts(:stderr, ["\n", Profile.render(report.snapshot, wall_s)])
    if opts[:headless], do: 0, else: serve_studio(path, opts)
  end

  defp write_transcript(recording, truth, path, opts) do
    if opts[:transcript] do
      lines = Transcript.attribute_utterances(recording.utterances, recording.found)
      file = path <> ".vtt"
      File.write!(file, Transcript.to_webvtt(lines))
      %{lines: lines, file: file, score: truth && Transcript.score_lines(lines, truth)}
    end
  end

  # A recording that ended with an error is readable up to that point, so its content is shown anyway.
  defp print_partial_results(error, opts) do
    with %{report: %{result: %{path: path}}} <- error.meta,
         false <- opts[:json] == true,
         {:ok, %{frames: n} = recording} when n > 0 <- RecordingSummary.read(path) do
      IO.puts(["Until it failed:\n", render_table(opts, recording, nil, 0.0, path)])
    end

    CommandLine.print_error(error)
  end

  defp render_table(opts, recording, score, wall_s, path, said \\ nil) do
    Table.render(%{
      opts: opts,
      recording: recording,
      score: score,
      wall_s: wall_s,
      path: path,
      said: said
    })
  end

  defp read_truth(nil), do: {:ok, nil}
  defp read_truth(path), do: GroundTruth.read(path)

  defp serve_studio(path, opts) do
    case Situ.Studio.start_link(path: path, port: opts[:port]) do
      {:ok, studio} ->
        url = Situ.Studio.url(studio, Situ.Studio.only_item(studio))
        IO.puts(:stderr, "The recording is at #{url} (Ctrl-C to stop)")
        if opts[:open], do: Situ.CLI.Desktop.open_url(url)
        Process.sleep(:infinity)

      {:error, error} ->
        CommandLine.print_error(error)
    end
  end
end
