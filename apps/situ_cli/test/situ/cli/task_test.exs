defmodule Situ.CLI.TaskTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.{Dataset, Message, Store}

  @moduletag :tmp_dir
  @clip Path.expand("../../../../situ_examples/priv/demo/talk1.mp4", __DIR__)

  defp run(argv), do: with_io(fn -> Situ.CLI.run(["task" | argv]) end)

  setup %{tmp_dir: root} do
    for i <- 1..2 do
      {:ok, writer} = Store.Writer.create("room", Path.join(root, "p#{i}"))
      {:ok, level} = Store.Writer.stream(writer, "Level", type: :integer)
      {:ok, _} = Store.Writer.stream(writer, "Secret", type: :string)

      messages =
        for n <- 0..9,
            do: %Message{
              data: n * i,
              originating_time: n * 1_000,
              creation_time: n * 1_000,
              sequence_id: n + 1
            }

      {:ok, _} = Store.Writer.append(level, messages)
      :ok = Store.Writer.close(writer)
    end

    file = Path.join(root, "study.json")
    {:ok, dataset} = Dataset.open(root)
    {:ok, _} = Dataset.save_as(dataset, file)
    %{study: file}
  end

  test "lists the tasks of all applications with their options" do
    {0, text} = run(["list"])

    for name <-
          ~w(statistics drop-streams sound-to-wav encode-pictures voice-activity transcript faces anonymise),
        do: assert(text =~ name)

    assert text =~ "quality: JPEG quality. (default 90)"
  end

  test "writes a statistics file for each session", %{study: file, tmp_dir: root} do
    assert {0, text} = run(["run", file, "statistics"])
    assert text =~ "p1: done" and text =~ "p2: done"
    {:ok, json} = Situ.JSON.decode(File.read!(Path.join(root, "p2/p2.statistics.json")))

    assert %{"count" => 10, "mean" => 9.0, "least" => 0, "most" => 18, "deviation" => deviation} =
             json["[room]:Level"]

    assert_in_delta deviation, 6.0553, 0.001
  end

  test "runs a pipeline from a file", %{study: file, tmp_dir: root} do
    own = Path.join(root, "doubled.ex")

    File.write!(own, """
    defmodule Situ.CLI.TaskTest.Doubled do
      def build(_p, opts) do
        opts[:importer]
        |> Situ.Dataset.Importer.stream("Level")
        |> Situ.map(&(&1 * 2))
        |> Situ.Store.write(opts[:exporter], "Twice")
      end
    end
    """)

    argv = ["dataset", "run", file, own, "--json"]
    assert {0, json} = with_io(fn -> Situ.CLI.run(argv) end)
    assert {:ok, %{"output" => "Doubled", "results" => [_, _]}} = Situ.JSON.decode(json)
    {:ok, dataset} = Dataset.open(file)
    partition = Enum.find(hd(dataset.sessions).partitions, &(&1.name == "Doubled"))
    twice = partition.path |> Store.open!() |> Store.messages("Twice") |> Enum.map(& &1.data)
    assert twice == for(n <- 0..9, do: n * 2)

    File.write!(own, "defmodule Broken do")
    said = capture_io(:stderr, fn -> assert Situ.CLI.run(["dataset", "run", file, own]) == 1 end)
    assert said =~ "cannot be compiled"
    File.write!(own, "1 + 1")
    said = capture_io(:stderr, fn -> assert Situ.CLI.run(["dataset", "run", file, own]) == 1 end)
    assert said =~ "no task and no pipeline"
  end

  test "shows when the code or the recordings of a partition have changed, and makes it again",
       ctx do
    %{study: file, tmp_dir: root} = ctx
    own = Path.join(root, "scaled.ex")

    write = fn factor ->
      :code.purge(Situ.CLI.TaskTest.Scaled)
      :code.delete(Situ.CLI.TaskTest.Scaled)

      File.write!(own, """
      defmodule Situ.CLI.TaskTest.Scaled do
        def task do
          options = [add: [type: :integer, default: 0]]
          %{name: "scaled", about: "", output: "Scaled", options: options}
        end

        def build(_p, opts) do
          "[room]:Level" |> opts[:open].() |> Situ.map(&(&1 * #{factor} + opts[:add])) |> opts[:write].("Level")
        end
      end
      """)
    end

    dataset = fn argv -> with_io(fn -> Situ.CLI.run(["dataset" | argv]) end) end

    values = fn session ->
      {:ok, dataset} = Dataset.load(file)
      {:ok, session} = Dataset.session(dataset, session)
      partition = Enum.find(session.partitions, &(&1.name == "Scaled"))
      partition.path |> Store.open!() |> Store.messages("Level") |> Enum.map(& &1.data)
    end

    write.(2)
    assert {0, _} = run(["run", file, own, "--set", "add=1"])
    assert {0, _} = run(["run", file, "drop-streams", "--set", ~s(drop=["Secret"])])
    assert values.("p1") == for(n <- 0..9, do: n * 2 + 1)
    refresh = ["refresh", file, "--code", own]
    assert {0, "All partitions of tasks are up to date.\n"} = dataset.(refresh)

    # The dataset file does not say which file is run.
    refute File.read!(file) =~ root <> "/scaled.ex"
    said = capture_io(:stderr, fn -> assert {0, _} = dataset.(["refresh", file]) end)
    assert said =~ "scaled.ex was not compared"

    write.(3)
    assert {0, said} = dataset.(refresh ++ ["--dry-run"])
    assert said =~ "p1, Scaled (scaled.ex): the code has changed"
    assert said =~ "p2, Scaled" and values.("p1") == for(n <- 0..9, do: n * 2 + 1)
    assert {0, said} = dataset.(refresh ++ ["--session", "p1"])
    assert said =~ "p1: done"
    # The options are those of the first run.
    assert values.("p1") == for(n <- 0..9, do: n * 3 + 1)
    assert values.("p2") == for(n <- 0..9, do: n * 4 + 1)

    # A recording that is made again later is an input of the partitions after it.
    assert {0, _} = dataset.(refresh)
    assert values.("p2") == for(n <- 0..9, do: n * 6 + 1)
    assert {0, said} = dataset.(refresh)
    assert said =~ "up to date"

    {:ok, writer} = Store.Writer.create("room", Path.join(root, "p1"))
    {:ok, level} = Store.Writer.stream(writer, "Level", type: :integer)
    message = %Message{data: 7, originating_time: 1, creation_time: 1, sequence_id: 1}
    {:ok, _} = Store.Writer.append(level, [message])
    :ok = Store.Writer.close(writer)
    {:ok, study} = Dataset.load(file)
    new = &Dataset.Session.replace_partition(&1, Dataset.Partition.new("room", writer.path))
    {:ok, _} = Dataset.update(study, fn d -> Dataset.update_session(d, "p1", new) end)
    assert {0, said} = dataset.(["info", file])
    assert said =~ "p1, Scaled (scaled.ex): the recordings have changed"
    assert {0, _} = dataset.(refresh)
    assert values.("p1") == [22]
  end

  test "drops streams, with options from a saved file", %{
    study: file,
    tmp_dir: root
  } do
    config = Path.join(root, "drop.json")

    assert capture_io(:stderr, fn ->
             assert Situ.CLI.run(["task", "run", file, "drop-streams"]) == 1
           end) =~ "drop"

    assert {0, _} =
             run([
               "run",
               file,
               "drop-streams",
               "--set",
               ~s(drop=["Sec*"]),
               "--save-config",
               config,
               "--session",
               "p1"
             ])

    assert {0, _} = run(["run", file, "drop-streams", "--config", config, "--session", "p2"])
    {:ok, dataset} = Dataset.open(file)

    for session <- dataset.sessions do
      {:ok, shared} = Dataset.Session.fetch_partition(session, "Shared")
      {:ok, store} = Dataset.Partition.open(shared)
      assert Enum.map(Store.streams(store), & &1.name) == ["Level"]
    end

    said =
      capture_io(:stderr, fn ->
        assert Situ.CLI.run(["task", "run", file, "drop-streams", "--config", config]) == 1
      end)

    assert said =~ "overwrite"

    assert capture_io(:stderr, fn ->
             assert Situ.CLI.run(["task", "run", file, "statistic"]) == 1
           end) =~ "statistics"
  end

  test "does not read its old output as input when it replaces it", %{study: file} do
    argv = ["run", file, "drop-streams", "--set", ~s(drop=["Secret"]), "--session", "p1"]
    assert {0, _} = run(argv)
    assert {0, _} = run(argv ++ ["--overwrite"])
    {:ok, dataset} = Dataset.open(file)
    {:ok, session} = Dataset.session(dataset, "p1")
    {:ok, shared} = Dataset.Session.fetch_partition(session, "Shared")
    {:ok, store} = Dataset.Partition.open(shared)
    assert Enum.map(Store.streams(store), & &1.name) == ["Level"]
  end

  # Adds the demo's clip as the only recording of a session.
  defp clip(file, root) do
    clip = Path.join(root, "p3/talk1.mp4")
    File.mkdir_p!(Path.dirname(clip))
    File.cp!(@clip, clip)
    {:ok, dataset} = Dataset.open(file)
    {:ok, dataset} = Dataset.add_recording(dataset, clip, session: "p3")
    {:ok, _} = Dataset.save(dataset)
    :ok
  end

  defp derived(root, name) do
    {:ok, store} = Store.open(Path.join(root, "p3/#{name}"))
    store
  end

  @tag timeout: 300_000
  test "finds, tracks and hides faces, and mutes audio", %{study: file, tmp_dir: root} do
    clip(file, root)
    assert {0, _} = run(["run", file, "faces", "--session", "p3"])
    faces = Enum.map(Store.messages(derived(root, "Faces"), "Faces"), & &1.data)
    assert length(faces) == 350
    both = Enum.count(faces, &(Enum.map(&1, fn face -> face.rect.id end) == [0, 1]))
    assert both >= 345

    argv = ["--set", ~s(mute=["1-3.5"]), "--set", "drop=Faces", "--set", "quality=95"]
    assert {0, _} = run(["run", file, "anonymise", "--session", "p3" | argv])
    store = derived(root, "Anonymous")
    assert Enum.map(Store.streams(store), & &1.name) |> Enum.sort() == ["Audio", "Video"]

    silent =
      for m <- Store.messages(store, "Audio"),
          m.data.data == :binary.copy(<<0>>, 640),
          do: m.originating_time

    assert Enum.min_max(silent) == {1_020_000_000, 3_500_000_000}

    for k <- [0, 120, 349] do
      {:ok, message} = Store.at(store, "Video", k)
      {:ok, picture} = Situ.ImageOps.parse(message.data)
      assert {picture.width, picture.height} == {1024, 512}
      for face <- Enum.at(faces, k), do: assert(smooth?(picture, face.rect))
    end
  end

  # No detail is left, so adjacent rows are almost equal.
  defp smooth?(picture, rect) do
    part = picture |> Situ.ImageOps.convert!(:gray8) |> Situ.ImageOps.crop!(rect)
    rows = for <<row::binary-size(part.width) <- part.data>>, do: :binary.bin_to_list(row)

    steps =
      rows
      |> Enum.zip(tl(rows))
      |> Enum.flat_map(fn {a, b} -> Enum.zip_with(a, b, &abs(&1 - &2)) end)

    Enum.sum(steps) / length(steps) < 1.5
  end

  @tag :moonshine
  @tag timeout: 300_000
  test "writes a transcript", %{study: file, tmp_dir: root} do
    clip(file, root)
    assert {0, _} = run(["run", file, "transcript", "--session", "p3"])
    said = Enum.map(Store.messages(derived(root, "Transcript"), "Transcript"), & &1.data.text)
    assert Enum.join(said, " ") =~ ~r/go forward ten meters/i
  end

  test "detects voice activity in stereo audio", %{tmp_dir: root} do
    format = Situ.AudioFormat.pcm(44_100, 2)

    data =
      for i <- 1..22_050,
          into: <<>>,
          do: <<rem(i * 7, 200)::little-16, rem(i * 5, 90)::little-16>>

    folder = Path.join(root, "stereo")
    {:ok, writer} = Store.Writer.create("room", folder)
    {:ok, audio} = Store.Writer.stream(writer, "Audio", type: Situ.AudioBuffer)
    buffer = Situ.AudioBuffer.new!(format: format, data: data)

    message = %Message{
      data: buffer,
      originating_time: 500_000_000,
      creation_time: 500_000_000,
      sequence_id: 1
    }

    {:ok, _} = Store.Writer.append(audio, [message])
    :ok = Store.Writer.close(writer)
    assert {0, _} = with_io(:stderr, fn -> elem(run(["run", folder, "voice-activity"]), 0) end)
    {:ok, voice} = Store.open(Path.join(folder, "Voice"))
    assert Store.count(voice, "Speaking") >= 14
  end

  test "writes a video's audio as WAV, and reports the failure of one session", %{
    study: file,
    tmp_dir: root
  } do
    clip(file, root)
    assert {1, text} = run(["run", file, "sound-to-wav"])
    assert text =~ "p3: done" and text =~ ~r/p1: failed: .*"Audio"/
    {:ok, wav} = Store.open(Path.join(root, "p3/p3.Audio.wav"))
    assert {first, last} = Store.interval(wav)
    assert_in_delta (last - first) / 1.0e9, 14.0, 0.2
  end
end
