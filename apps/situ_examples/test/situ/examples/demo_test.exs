defmodule Situ.Examples.DemoTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO

  alias Situ.Examples.Demo
  alias Situ.Examples.Demo.{Options, RecordingSummary, Score, GroundTruth}
  alias Situ.Store

  @moduletag timeout: 240_000
  @truth Path.join(Path.dirname(Options.default_clip()), "talk1.truth.json")

  defp ffmpeg!(args) do
    {out, status} = System.cmd("ffmpeg", ~w(-v error -y) ++ args, stderr_to_stdout: true)
    assert status == 0, out
  end

  defp messages(path) do
    {:ok, store} = Store.open(path)

    for %{name: name} <- Store.streams(store), name != "Talk.Diagnostics", into: %{} do
      rows =
        store |> Store.messages(name) |> Enum.map(&{&1.originating_time, &1.sequence_id, &1.data})

      {name, :erlang.term_to_binary(rows)}
    end
  end

  @tag :tmp_dir
  test "scores the clip correctly, and two runs record the same bytes", %{tmp_dir: dir} do
    assert {:ok, %{result: %{path: one}} = report, _} =
             Demo.record_clip(input: Options.default_clip(), out: dir)

    assert {:ok, %{result: %{path: two}}, _} =
             Demo.record_clip(input: Options.default_clip(), out: dir)

    assert one != two
    first = messages(one)

    assert Map.keys(first) |> Enum.sort() ==
             ~w(Talk.Faces Talk.Mouths Talk.Mouths.Opening Talk.Pictures Talk.Sound Talk.Speaking) ++
               ~w(Talk.Voice Talk.Voice.Probability Talk.Voice.Segments)

    assert first == messages(two)

    rows = Demo.Profile.component_rows(report.snapshot)
    assert %{calls: 350, mean_ms: ms} = Enum.find(rows, &(&1.path =~ "FaceLandmarks"))
    assert ms > 0
    text = IO.iodata_to_binary(Demo.Profile.render(report.snapshot, 5.0))
    assert text =~ "FaceDetector" and text =~ "calls"

    {:ok, truth} = GroundTruth.read(@truth)
    {:ok, recording} = RecordingSummary.read(one)
    score = Score.score_decisions(truth, recording.found)
    assert score.frames == 350
    assert score.frame_accuracy >= 0.97
    # Nobody speaks while the voice comes from off-screen, or while a mouth moves in silence.
    for {from, to} <- [{10.2, 11.8}, {12.2, 13.6}], {_, a, b} <- recording.spoken do
      refute a / 1.0e9 < to and b / 1.0e9 > from
    end
  end

  @tag :tmp_dir
  @tag :moonshine
  test "--transcript: every utterance at the right face, at most 15 % of the words wrong", %{
    tmp_dir: dir
  } do
    argv = [
      "--input",
      Options.default_clip(),
      "--truth",
      @truth,
      "--transcript",
      "--headless",
      "--json",
      "--out",
      dir
    ]

    out = capture_io(fn -> assert Demo.run(argv) == 0 end)
    {:ok, json} = Situ.JSON.decode(out)
    assert json["right_face"] == 1.0 and json["wer"] <= 0.15
    assert [%{"face" => 0, "from" => from, "text" => "He might" <> _} | _] = json["utterances"]
    assert_in_delta from, 0.76, 0.3
    assert List.last(json["utterances"])["face"] == nil
    assert File.read!(json["recording"] <> ".vtt") =~ "<v face 1>Go forward"
  end

  @tag :tmp_dir
  test "prints one JSON object with --json", %{tmp_dir: dir} do
    short = Path.join(dir, "short.mp4")
    ffmpeg!(["-i", Options.default_clip(), "-t", "2", short])
    argv = ["--", "--input", short, "--truth", @truth, "--headless", "--json", "--out", dir]
    out = capture_io(fn -> assert Demo.run(argv) == 0 end)
    {:ok, json} = Situ.JSON.decode(out)

    for key <-
          ~w(frames scored_frames frame_accuracy false_speech_s missed_speech_s per_face wall_s media_s),
        do: assert(Map.has_key?(json, key), "#{key} is missing")

    assert json["frames"] == 350
    assert_in_delta json["media_s"], 2.0, 0.1
  end

  @tag :tmp_dir
  test "detects late audio, reports it and shifts it, so the speaker is correct again", %{
    tmp_dir: dir
  } do
    late = Path.join(dir, "late.mp4")

    # The audio of the clip 300 ms later, with the same images.
    ffmpeg!(
      ["-i", Options.default_clip(), "-itsoffset", "0.3", "-i", Options.default_clip()] ++
        ~w(-t 8 -map 0:v -map 1:a -c:v copy -c:a aac) ++ [late]
    )

    argv = ["--input", late, "--truth", @truth, "--headless", "--out", dir]
    out = capture_io(fn -> assert Demo.run(argv) == 0 end)
    assert [_, ms] = Regex.run(~r/The audio is (\d+) ms late relative to the lips/, out)
    assert_in_delta String.to_integer(ms), 300, 60
    assert out =~ "it was shifted by that"
    # The recording that was out of sync was deleted; in the other one the audio is in sync.
    assert [path] = Store.list(dir)
    {:ok, recording} = RecordingSummary.read(path)
    refute Situ.Infer.LipSync.out_of_sync?(recording.sync)
    assert_in_delta recording.sync.shift / 1.0e6, 0.0, 60.0

    # As good as the clip in sync, over the available part.
    {:ok, truth} = GroundTruth.read(@truth)
    truth = %{truth | frames: 200}
    assert Score.score_decisions(truth, recording.found).frame_accuracy >= 0.96
    # The output explains the year 1970.
    assert out =~ "1970" and out =~ "latencies in the recording are not real time"
  end

  @tag :tmp_dir
  test "continues without audio, images or faces", %{tmp_dir: dir} do
    silent = Path.join(dir, "silent.mp4")
    ffmpeg!(["-i", Options.default_clip(), "-t", "1", "-an", silent])

    out =
      capture_io(fn -> assert Demo.run(["--input", silent, "--headless", "--out", dir]) == 0 end)

    assert out =~ "no audio" and out =~ "25 images"

    voice = Path.join(dir, "voice.wav")
    ffmpeg!(["-i", Options.default_clip(), "-t", "1", "-vn", voice])

    out =
      capture_io(fn -> assert Demo.run(["--input", voice, "--headless", "--out", dir]) == 0 end)

    assert out =~ "no video"

    empty = Path.join(dir, "empty.mp4")

    ffmpeg!(
      ~w(-f lavfi -i color=c=gray:s=320x240:r=10:d=1 -f lavfi -i sine=d=1 -shortest) ++ [empty]
    )

    out =
      capture_io(fn -> assert Demo.run(["--input", empty, "--headless", "--out", dir]) == 0 end)

    assert out =~ "Nobody was seen speaking"
  end

  @tag :tmp_dir
  @tag :capture_log
  test "shows the readable part of a truncated clip and reports the error", %{tmp_dir: dir} do
    cut = Path.join(dir, "cut.mp4")
    File.write!(cut, Options.default_clip() |> File.read!() |> binary_part(0, 300_000))
    argv = ["--input", cut, "--headless", "--out", dir]

    err =
      capture_io(:stderr, fn ->
        out = capture_io(fn -> assert Demo.run(argv) == 1 end)
        assert out =~ "Until it failed" and out =~ " images, "
      end)

    assert err =~ "cut.mp4 is damaged"
  end

  @tag :tmp_dir
  test "reports invalid arguments and files", %{tmp_dir: dir} do
    err = fn argv, status -> capture_io(:stderr, fn -> assert Demo.run(argv) == status end) end
    assert err.(["--inptu", "x"], 2) =~ "unknown or incomplete option"
    assert err.(["--input", "/nowhere.mp4", "--headless", "--out", dir], 1) =~ "Fix:"
    bad = Path.join(dir, "bad.json")
    File.write!(bad, "{")
    assert err.(["--truth", bad, "--headless", "--out", dir], 1) =~ "not JSON"
    assert capture_io(fn -> assert Demo.run(["--help"]) == 0 end) =~ "Usage"
  end
end
