defmodule Situ.Dataset.DerivationTest do
  use ExUnit.Case, async: true
  import Situ.Test.Eventually
  import Situ.Dataset.Test.Study
  alias Situ.{Dataset, Store}
  alias Situ.Dataset.{Importer, OpenSession}
  alias Situ.Dataset.Derivation.Report

  @moduletag :tmp_dir

  defmodule Square do
    @moduledoc false
    use Situ.Pipeline

    @impl true
    def build(_p, opts) do
      opts[:importer]
      |> Importer.stream("Level")
      |> Situ.map(&(&1 ** opts[:power]), type: :integer)
      |> Store.write(opts[:exporter], "Square")

      opts[:session].name
    end
  end

  defp double(_p, importer, exporter) do
    importer |> Importer.stream("Level") |> Situ.map(&(&1 * 2)) |> Store.write(exporter, "Twice")
  end

  defp values(dataset, session, stream) do
    {:ok, session} = Dataset.session(dataset, session)
    {:ok, messages} = OpenSession.messages(OpenSession.open(session), stream)
    Enum.map(messages, & &1.data)
  end

  defp statuses(report), do: Enum.map(report.results, &{&1.session, &1.status})
  defp left_over(root), do: Path.wildcard(Path.join(root, "**/*.{unfinished,run}"))

  test "adds the output to every session as a partition", %{tmp_dir: root} do
    {:ok, dataset} = Dataset.save(dataset(root, 3))
    test = self()

    {:ok, dataset, report} =
      Dataset.derive(dataset, &double/3,
        output: "Doubled",
        parallel: 2,
        progress: &send(test, {:at, &1})
      )

    assert statuses(report) == [{"p1", :done}, {"p2", :done}, {"p3", :done}]

    for s <- ["p1", "p2", "p3"],
        do: assert(values(dataset, s, "Twice") == for(i <- 0..9, do: 2 * i))

    assert {:ok, ^dataset} = Dataset.open(dataset.file)
    assert left_over(root) == []
    assert File.dir?(Path.join(root, "p1/Doubled.0000"))
    assert_received {:at, %{done: 1.0, finished: 3, total: 3}}
  end

  test "runs a module with options over some sessions into another folder", %{tmp_dir: root} do
    dataset = dataset(root, 3)

    opts = [
      output: "Sq",
      store: "sq",
      path: Path.join(root, "out"),
      sessions: ["p2"],
      options: [power: 3]
    ]

    {:ok, dataset, report} = Dataset.derive(dataset, Square, opts)
    assert [%{session: "p2", result: "p2"}] = report.results
    assert values(dataset, "p2", "Square") == for(i <- 0..9, do: i * i * i)
    assert File.dir?(Path.join(root, "out/p2/sq.0000"))
    assert {:error, %{code: :no_session}} = Dataset.derive(dataset, Square, sessions: ["p9"])
  end

  test "replays only the interval", %{tmp_dir: root} do
    replay = [interval: {103_000_000_000, 105_000_000_000}, speed: :max]
    opts = [output: "D", sessions: ["p1"], pipeline: [replay: replay]]
    {:ok, dataset, _} = Dataset.derive(dataset(root, 1), &double/3, opts)
    assert values(dataset, "p1", "Twice") == [6, 8, 10]
  end

  test "rejects an existing output or replaces it, and keeps the old recording", %{
    tmp_dir: root
  } do
    {:ok, dataset, _} = Dataset.derive(dataset(root, 2), &double/3, output: "D", sessions: ["p2"])

    assert {:error, %{code: :partition_exists, why: why}} =
             Dataset.derive(dataset, &double/3, output: "D")

    assert why =~ "p2"
    {:ok, dataset, report} = Dataset.derive(dataset, &double/3, output: "D", overwrite: true)
    assert statuses(report) == [{"p1", :done}, {"p2", :done}]
    {:ok, session} = Dataset.session(dataset, "p2")
    assert Enum.map(session.partitions, &Path.basename(&1.path)) == ["room.0000", "D.0001"]
    assert Store.exists?(Path.join(root, "p2/D.0000"))
  end

  test "returns the results of runs without an output", %{tmp_dir: root} do
    dataset = dataset(root, 2)
    test = self()

    {:ok, same, report} =
      Dataset.derive(dataset, fn _p, importer, nil ->
        importer |> Importer.stream("Level") |> Situ.each(&send(test, {:level, &1}))
        :built
      end)

    assert same == dataset
    assert Enum.map(report.results, & &1.result) == [:built, :built]
    for _ <- 1..20, do: assert_received({:level, _})
  end

  test "reports a failing session, and completes the others", %{tmp_dir: root} do
    dataset = dataset(root, 3)
    # Session p2 lacks the stream, and p3 fails in the middle.
    other = record(Path.join(root, "p2"), "other", %{"Else" => ten(0)})

    {:ok, dataset} =
      Dataset.update_session(dataset, "p2", fn s ->
        {:ok, put_in(s.partitions, [Dataset.Partition.new("Room", other)])}
      end)

    run = fn _p, importer, exporter ->
      name = importer.session.session.name
      check = fn x -> if name == "p3" and x == 5, do: raise("five"), else: x end
      importer |> Importer.stream("Level") |> Situ.map(check) |> Store.write(exporter, "Checked")
    end

    {:ok, dataset, report} = Dataset.derive(dataset, run, output: "C")
    assert statuses(report) == [{"p1", :done}, {"p2", :failed}, {"p3", :failed}]
    assert [{"p2", %{code: :no_stream}}, {"p3", error}] = Report.failures(report)
    assert Exception.message(error) =~ "five"
    assert Enum.map(dataset.sessions, &length(&1.partitions)) == [2, 1, 1]
    assert [journal] = left_over(root)
    assert Path.extname(journal) == ".run"

    # The next run retries the failed sessions.
    {:ok, _, report} = Dataset.derive(dataset, run, output: "C")
    assert statuses(report) == [{"p1", :kept}, {"p2", :failed}, {"p3", :failed}]

    {:ok, _, report} = Dataset.derive(dataset, run, output: "E", on_failure: :stop)
    assert {"p2", :failed} in statuses(report)
    assert report.cancelled?
  end

  test "fails a session without any recordings, and runs those with others", %{
    tmp_dir: root
  } do
    dataset = dataset(root, 2)
    lost = Dataset.Partition.new("Lost", Path.join(root, "nowhere.0000"))

    {:ok, dataset} =
      Dataset.update_session(dataset, "p1", &Dataset.Session.add_partition(&1, lost))

    {:ok, dataset} = Dataset.update_session(dataset, "p2", &{:ok, put_in(&1.partitions, [lost])})

    copy = Situ.Dataset.Task.DropStreams
    {:ok, _, report} = Dataset.derive(dataset, copy, output: "Shared", options: [drop: ["x"]])
    assert statuses(report) == [{"p1", :done}, {"p2", :failed}]
    assert [{"p2", %{what: what}}] = Report.failures(report)
    assert what =~ "nowhere.0000"
  end

  # Creates `n` sessions: number `long` lasts a hundred seconds, the others nine milliseconds.
  defp uneven(root, n, long) do
    {:ok, dataset} = Dataset.new("Study", file: Path.join(root, "study.json"))

    dataset =
      Enum.reduce(1..n, dataset, fn i, dataset ->
        step = if i == long, do: 10_000_000_000, else: 1_000_000
        items = for k <- 0..9, do: {k * step, k}
        path = record(Path.join(root, "p#{i}"), "room", %{"Level" => items})
        {:ok, dataset} = Dataset.add_session(dataset, "p#{i}")
        {:ok, dataset} = Dataset.add_partition(dataset, "p#{i}", "Room", path)
        dataset
      end)

    {:ok, dataset} = Dataset.save(dataset)
    dataset
  end

  test "a cancelled run keeps finished outputs and removes unfinished ones", %{tmp_dir: root} do
    dataset = uneven(root, 3, 2)
    flag = :atomics.new(1, [])

    run = fn p, importer, exporter ->
      if importer.session.session.name == "p2", do: :atomics.put(flag, 1, 1)
      double(p, importer, exporter)
    end

    cancel = fn -> :atomics.get(flag, 1) == 1 end
    opts = [output: "D", cancel: cancel, pipeline: [replay: [speed: 1.0]]]
    {:ok, dataset, report} = Dataset.derive(dataset, run, opts)
    assert report.cancelled?
    assert statuses(report) == [{"p1", :done}, {"p2", :cancelled}]
    assert Enum.map(dataset.sessions, &length(&1.partitions)) == [2, 1, 1]
    assert Path.wildcard(Path.join(root, "*/*.unfinished")) == []
    {:ok, _, report} = Dataset.derive(dataset, &double/3, output: "D")
    assert statuses(report) == [{"p1", :kept}, {"p2", :done}, {"p3", :done}]
    assert left_over(root) == []
  end

  test "resumes a killed run", %{tmp_dir: root} do
    dataset = uneven(root, 4, 3)

    # Another operating system process is killed in the middle of the third session.
    code = """
    {:ok, _} = Application.ensure_all_started(:situ_dataset)
    {:ok, dataset} = Situ.Dataset.open(#{inspect(dataset.file)})
    Situ.Dataset.derive(dataset, fn _p, importer, exporter ->
      IO.puts(importer.session.session.name)
      importer |> Situ.Dataset.Importer.stream("Level") |> Situ.map(& &1 * 2) |> Situ.Store.write(exporter, "Twice")
    end, output: "D", pipeline: [replay: [speed: 1.0]])
    """

    paths = Enum.flat_map(:code.get_path(), &["-pa", to_string(&1)])
    elixir = System.find_executable("elixir")
    port = Port.open({:spawn_executable, elixir}, [:binary, args: paths ++ ["-e", code]])
    for line <- ["p1\n", "p2\n", "p3\n"], do: assert_receive({^port, {:data, ^line}}, 60_000)
    {:os_pid, pid} = Port.info(port, :os_pid)

    assert eventually(
             fn -> Path.wildcard(Path.join(root, "p3/*.unfinished/index.situ")) != [] end,
             60_000
           )

    {_, 0} = System.cmd("kill", ["-9", "#{pid}"])
    assert eventually(fn -> Port.info(port) == nil end)

    assert Enum.sort(Enum.map(left_over(root), &Path.extname/1)) == [".run", ".unfinished"]
    {:ok, dataset} = Dataset.open(dataset.file)
    assert Enum.map(dataset.sessions, &length(&1.partitions)) == [2, 2, 1, 1]
    {:ok, dataset, report} = Dataset.derive(dataset, &double/3, output: "D", overwrite: true)
    assert statuses(report) == [{"p1", :kept}, {"p2", :kept}, {"p3", :done}, {"p4", :done}]

    for s <- ["p1", "p2", "p3", "p4"],
        do: assert(values(dataset, s, "Twice") == for(i <- 0..9, do: 2 * i))

    assert left_over(root) == []
    assert Path.wildcard(Path.join(root, "p1/D.*")) == [Path.join(root, "p1/D.0000")]
  end
end
