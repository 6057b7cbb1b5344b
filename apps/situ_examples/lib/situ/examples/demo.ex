defmodule Situ.Examples.Demo do
  @usage """
  Usage: bin/demo [--input FILE|camera] [--truth FILE.json] [--headless] [--json] [--realtime]

  Finds out who is speaking in a clip, from sound and lips; records everything; prints who spoke when; then serves the
  studio on the recording.

    --input FILE     a media file (default: the clip that comes with Situ); "camera" for the first camera and the
                     default microphone; any other device name, as "simulated:talk1.mp4?once"
    --truth FILE     what really happens in the clip: prints the score
    --out FOLDER     where the recording goes (default: "recordings")
    --realtime       at the speed of the clip, instead of as fast as possible
    --seconds N      stop after N seconds (for cameras; default: until Enter is pressed)
    --headless       do not serve the studio afterwards
    --json           print one JSON object and nothing else
    --transcript     recognise what is said (English), print who said what, and write it beside the recording as WebVTT
    --profile        print where the time went, component by component
    --port N         the studio's port (default 4040; 0 takes a free one)
    --no-open        do not open a browser
    --cluster        on three nodes, one of which is killed in the middle (--cluster --help)
    --dataset        a study instead: clips as a dataset, annotated, exported, compared (--dataset --help)
    --scene          a room in three dimensions instead, with all that is found in it (--scene --help)

  Exit status: 0 done, 1 it failed, 2 wrong usage.
  """
  @moduledoc """
  The demo, `bin/demo`: `Situ.Examples.MultimodalVoiceActivity` on a clip or a camera, with a table and a score.

  ```text
  #{@usage}
  ```
  """
  alias Situ.Error
  alias Situ.Examples.Demo.{Cluster, Options, Profile, Recording, Score, Table, Transcript, Truth}
  alias Situ.Examples.MultimodalVoiceActivity
  alias Situ.Infer.LipSync

  @doc "Runs the demo and ends the VM with its exit status."
  @spec main([String.t()]) :: no_return()
  def main(argv), do: argv |> run() |> System.halt()

  @doc "Runs the demo; answers the exit status."
  @spec run([String.t()]) :: 0 | 1 | 2
  def run(argv) do
    cond do
      "--dataset" in argv -> Situ.Examples.Study.run(argv)
      "--scene" in argv -> Situ.Examples.Demo.Scene.run(argv)
      "--cluster" in argv -> Cluster.run(argv, &record/1)
      true -> talk(argv)
    end
  end

  defp usage do
    IO.puts(@usage)
    0
  end

  defp talk(argv) do
    case Options.parse(argv) do
      {:ok, opts} -> demo(opts)
      :help -> usage()
      {:error, text} -> fail("#{text}\n  Fix: see bin/demo --help", 2)
    end
  end

  @doc """
  Runs the pipeline on what the options name. Answers its report, whose `result.path` is the recording's, and the
  seconds it took.

  Options: `input:`, `out:`, `realtime:`, `seconds:`, `sound_shift:`.
  """
  @spec record(keyword()) ::
          {:ok, Situ.Pipeline.Report.t(), wall_s :: float()} | {:error, Error.t()}
  def record(opts) do
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
      live(build, opts)
    else
      speed = if opts[:realtime], do: 1.0, else: :max
      settings = [name: "Talk", replay: [speed: speed]]
      Situ.Pipeline.run(MultimodalVoiceActivity, [{:pipeline, settings} | build])
    end
  end

  # A camera has no end: time or a person ends it. A simulated one that plays once ends by itself.
  defp live(build, opts) do
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

    # Without a terminal there is nobody to press it: then it runs until it is stopped from outside.
    if IO.gets("") == :eof, do: Process.sleep(:infinity)
    Situ.Pipeline.stop(p)
  end

  defp wait_for_end(p, seconds) do
    Process.sleep(round(seconds * 1000))
    Situ.Pipeline.stop(p)
  end

  defp demo(opts) do
    with {:ok, truth} <- truth(opts[:truth]) do
      case record(opts) do
        {:ok, report, wall_s} -> show(report, wall_s, truth, opts)
        {:error, error} -> salvage(error, opts)
      end
    else
      {:error, error} -> fail(Exception.message(error), 1)
    end
  rescue
    error in Error -> fail(Exception.message(error), 1)
  end

  defp show(%{result: %{path: path}} = report, wall_s, truth, opts) do
    with {:ok, recording} <- Recording.read(path) do
      if LipSync.off?(recording.sync) and movable?(opts),
        do: record_in_step(recording.sync, path, truth, opts),
        else: print(recording, report, wall_s, truth, opts)
    else
      {:error, error} -> fail(Exception.message(error), 1)
    end
  end

  # A camera cannot be asked again, and what has been moved once is left alone.
  defp movable?(opts), do: not opts[:live] and opts[:sound_shift] == nil

  defp record_in_step(sync, path, truth, opts) do
    opts = Keyword.merge(opts, sound_shift: -sync.shift, sync: sync)

    case record(opts) do
      {:ok, report, wall_s} ->
        # The recording that was out of step is the demo's own, and of no more use.
        Situ.Store.delete(path)
        show(report, wall_s, truth, opts)

      {:error, error} ->
        salvage(error, opts)
    end
  end

  defp print(recording, %{result: %{path: path}} = report, wall_s, truth, opts) do
    score = truth && Score.of(truth, recording.found)
    said = said(recording, truth, path, opts)
    IO.puts(table(opts, recording, score, wall_s, path, said))
    if opts[:profile], do: IO.puts(:stderr, ["\n", Profile.render(report.snapshot, wall_s)])
    if opts[:headless], do: 0, else: serve(path, opts)
  end

  defp said(recording, truth, path, opts) do
    if opts[:transcript] do
      lines = Transcript.of(recording.utterances, recording.found)
      file = path <> ".vtt"
      File.write!(file, Transcript.webvtt(lines))
      %{lines: lines, file: file, score: truth && Transcript.score(lines, truth)}
    end
  end

  # A recording that ended by an error is whole up to there: what is in it is shown all the same.
  defp salvage(error, opts) do
    with %{report: %{result: %{path: path}}} <- error.meta,
         false <- opts[:json] == true,
         {:ok, %{frames: n} = recording} when n > 0 <- Recording.read(path) do
      IO.puts(["Until it failed:\n", table(opts, recording, nil, 0.0, path)])
    end

    fail(Exception.message(error), 1)
  end

  defp table(opts, recording, score, wall_s, path, said \\ nil) do
    Table.render(%{
      opts: opts,
      recording: recording,
      score: score,
      wall_s: wall_s,
      path: path,
      said: said
    })
  end

  defp truth(nil), do: {:ok, nil}
  defp truth(path), do: Truth.read(path)

  defp serve(path, opts) do
    case Situ.Studio.start_link(path: path, port: opts[:port]) do
      {:ok, studio} ->
        url = Situ.Studio.url(studio, Situ.Studio.only_item(studio))
        IO.puts(:stderr, "The recording is at #{url} (Ctrl-C to stop)")
        if opts[:open], do: Situ.CLI.Desktop.open(url)
        Process.sleep(:infinity)

      {:error, error} ->
        fail(Exception.message(error), 1)
    end
  end

  defp fail(text, status) do
    IO.puts(:stderr, "bin/demo: " <> text)
    status
  end
end
