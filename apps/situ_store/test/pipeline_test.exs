defmodule Situ.Store.PipelineTest do
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.{Pipeline, Store}

  @moduletag :tmp_dir

  defp record(root, name, values, opts \\ []) do
    items = for {v, i} <- Enum.with_index(values), do: {i * 1_000_000, v}

    {:ok, report} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, name, root, opts)
        p |> Situ.from_enumerable(items) |> Store.write(exporter, "seq", type: :integer)
        exporter.writer.path
      end)

    report.result
  end

  defp replay(path, name, settings \\ [], opts \\ []) do
    test = self()

    {:ok, report} =
      Pipeline.run(
        fn p -> p |> Store.importer(path, opts) |> Store.stream(name) |> collect(test) end,
        pipeline: settings
      )

    received(report.result)
  end

  # Sends every message to the test; returns the tag to receive them by.
  defp collect(stream, test) do
    tag = make_ref()
    Situ.each(stream, fn _data, message -> send(test, {tag, message}) end)
    tag
  end

  defp received(tag, got \\ []) do
    receive do
      {^tag, message} -> received(tag, [message | got])
    after
      0 -> Enum.reverse(got)
    end
  end

  test "a pipeline records, another replays the same messages", %{tmp_dir: root} do
    path = record(root, "rec", 0..4_999)
    store = Store.open!(path)
    assert %{closed?: true, live?: false} = Store.info(store)
    assert [%{name: "seq", type: :integer, count: 5_000, closed: closed}] = Store.streams(store)
    assert closed >= 4_999_000_000
    written = Enum.to_list(Store.messages(store, "seq"))
    got = replay(path, "seq")
    assert Enum.map(got, & &1.data) == Enum.to_list(0..4_999)

    assert Enum.map(got, &{&1.originating_time, &1.sequence_id}) ==
             Enum.map(written, &{&1.originating_time, &1.sequence_id})

    assert Enum.map(got, & &1.creation_time) == Enum.map(written, & &1.creation_time)
  end

  test "an interval, both ends included, also beyond the ends", %{tmp_dir: root} do
    path = record(root, "rec", 0..99)
    ms = &(&1 * 1_000_000)

    values = fn interval ->
      path |> replay("seq", replay: [interval: interval]) |> Enum.map(& &1.data)
    end

    assert values.({ms.(90), ms.(95)}) == Enum.to_list(90..95)
    assert values.({ms.(90) - 5, :unbounded}) == Enum.to_list(90..99)
    assert values.({ms.(90) + 1, ms.(93) - 1}) == [91, 92]
    assert values.({:unbounded, ms.(3)}) == [0, 1, 2, 3]
    assert values.({ms.(1_000), ms.(2_000)}) == []
  end

  test "the clock of the replay is the recording's, at any speed", %{tmp_dir: root} do
    path = record(root, "rec", 0..99)

    for {speed, least} <- [{1.0, 95}, {4.0, 22}] do
      started = System.monotonic_time(:millisecond)
      got = replay(path, "seq", replay: [speed: speed])
      took = System.monotonic_time(:millisecond) - started
      assert length(got) == 100
      assert took >= least
    end
  end

  test "a lossy default policy loses nothing on the way to the disk", %{tmp_dir: root} do
    {:ok, report} =
      Pipeline.run(
        fn p ->
          exporter = Store.create(p, "lossy", root)
          p |> Situ.range(0, 20_000, 1_000) |> Store.write(exporter, "all")
          exporter.writer.path
        end,
        pipeline: [default_policy: Situ.Delivery.latest()]
      )

    assert [%{count: 20_000}] = report.result |> Store.open!() |> Store.streams()
  end

  test "derived streams are the same at every speed", %{tmp_dir: root} do
    fast = for i <- 0..599, do: {i * 1_000_000, i}
    slow = for i <- 0..59, do: {i * 10_000_000 + 300_000, i * 1.5}

    {:ok, report} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, "two", root)
        p |> Situ.from_enumerable(fast) |> Store.write(exporter, "fast")
        p |> Situ.from_enumerable(slow) |> Store.write(exporter, "slow")
        exporter.writer.path
      end)

    derive = fn replay ->
      test = self()

      {:ok, report} =
        Pipeline.run(
          fn p ->
            importer = Store.importer(p, report.result)

            importer
            |> Store.stream("fast")
            |> Situ.join(
              Store.stream(importer, "slow"),
              Situ.Reproducible.nearest(Situ.Time.ms(4))
            )
            |> Situ.filter(fn {i, _} -> rem(i, 3) != 0 end)
            |> Situ.scan({0, 0.0}, fn {i, x}, {n, sum} -> {n + i, sum + x} end)
            |> collect(test)
          end,
          pipeline: [replay: replay]
        )

      for m <- received(report.result), do: {m.originating_time, m.data}
    end

    reference = derive.(speed: :max)
    assert length(reference) > 300
    for speed <- [1.0, 4.0], do: assert(derive.(speed: speed) == reference)
  end

  test "under a manual clock messages come exactly when it reaches their times", %{tmp_dir: root} do
    path = record(root, "rec", 0..9)
    clock = Situ.Clock.manual(0)
    test = self()

    {:ok, p} =
      Pipeline.start_link(
        fn p ->
          p
          |> Store.importer(path)
          |> Store.stream("seq")
          |> Situ.each(fn data -> send(test, {:got, data}) end)
        end,
        pipeline: [clock: clock, replay: [speed: 1.0]]
      )

    assert_receive {:got, 0}
    refute_received {:got, 1}
    Situ.Clock.advance(clock, 3_000_000)
    for n <- 1..3, do: assert_receive({:got, ^n})
    refute_received {:got, 4}
    Situ.Clock.advance(clock, 6_000_000)
    for n <- 4..9, do: assert_receive({:got, ^n})
    assert {:ok, _} = Pipeline.await(p, 30_000)
  end

  test "pause, step, seek, resume", %{tmp_dir: root} do
    path = record(root, "rec", 0..999)
    test = self()

    {:ok, p} =
      Pipeline.start_link(
        fn p ->
          importer = Store.importer(p, path)
          send(test, {:importer, importer})
          importer |> Store.stream("seq") |> Situ.each(&send(test, {:got, &1}))
        end,
        pipeline: [replay: [speed: 0.0001]]
      )

    assert_receive {:importer, importer}
    assert_receive {:got, 0}
    :ok = Pipeline.pause(p)
    assert {:ok, 1_000_000} = Store.Importer.step(importer)
    assert_receive {:got, 1}
    assert {:ok, 2_000_000} = Store.Importer.step(importer)
    assert_receive {:got, 2}
    refute_received {:got, 3}
    :ok = Store.Importer.seek(importer, 995_000_000)
    assert Store.Importer.position(importer) == 995_000_000
    assert_receive {:got, 995}
    refute_received {:got, 500}
    :ok = Pipeline.set_speed(p, 1_000.0)
    :ok = Pipeline.resume(p)
    for n <- 996..999, do: assert_receive({:got, ^n})
    assert {:ok, _} = Pipeline.await(p, 30_000)
  end

  # A player of two streams, halted at 0; `expect.(n)` takes the messages up to and with `n` of both.
  defp player(root, opts) do
    test = self()
    {:ok, writer} = Store.Writer.create("two", root)

    for name <- ["a", "b"] do
      {:ok, stream} = Store.Writer.stream(writer, name, type: :integer)
      messages = for i <- 0..999, do: message(i, i * 1_000_000, i * 1_000_000 + 70, i + 1)
      {:ok, stream} = Store.Writer.append(stream, messages)
      {:ok, _} = Store.Writer.close_stream(stream, 999_000_000)
    end

    :ok = Store.Writer.close(writer)

    {:ok, p} =
      Pipeline.start_link(
        fn p ->
          importer = Store.importer(p, writer.path, opts)
          send(test, {:importer, importer})
          a = Store.stream(importer, "a")

          Situ.join(a, Store.stream(importer, "b"), Situ.Reproducible.exact())
          |> Situ.each(fn pair, m -> send(test, {:got, pair, m}) end)
        end,
        pipeline: [replay: [speed: 0.0001]]
      )

    assert_receive {:importer, importer}
    assert_receive {:got, {0, 0}, _}
    :ok = Pipeline.pause(p)
    {p, importer}
  end

  # The joined messages from the one of recorded time `from` ms on, up to and with that of `to` ms, and their times in the pipeline.
  defp joined(from, to) do
    for i <- from..to do
      assert_receive {:got, {^i, ^i}, m}
      # Latency is the recording's all the time.
      assert m.creation_time >= m.originating_time
      m.originating_time
    end
  end

  test "a seek back begins a new epoch, the same for all streams of the importer", %{
    tmp_dir: root
  } do
    {p, importer} = player(root, [])
    :ok = Store.Importer.seek(importer, 500_000_000)
    [at] = joined(500, 500)
    # Forward, beyond all that was handed out: pipeline time is recorded time.
    assert at == 500_000_000
    assert {:ok, 501_000_000} = Store.Importer.step(importer)
    [at] = joined(501, 501)

    :ok = Store.Importer.seek(importer, 100_000_000)
    [back] = joined(100, 100)
    assert back > at
    assert Store.Importer.position(importer) == 100_000_000
    # Within the epoch the distances are those of the recording.
    assert {:ok, 101_000_000} = Store.Importer.step(importer)
    assert joined(101, 101) == [back + 1_000_000]
    refute_received {:got, {102, _}, _}
    :ok = Store.Importer.seek(importer, 900_000_000)
    assert joined(900, 900) == [back + 800_000_000]

    # Again and again, also to before the beginning.
    for target <- [3, 700, 2, -5, 0, 998] do
      :ok = Store.Importer.seek(importer, target * 1_000_000)
      if target >= 0, do: assert([_] = joined(target, target))
    end

    :ok = Pipeline.set_speed(p, 1_000.0)
    :ok = Pipeline.resume(p)
    assert [_] = joined(999, 999)
    assert {:ok, _} = Pipeline.await(p, 30_000)
  end

  test "a player waits at its end to be sought", %{tmp_dir: root} do
    {p, importer} = player(root, keep_open: true)
    :ok = Store.Importer.seek(importer, 990_000_000)
    :ok = Pipeline.set_speed(p, 1_000.0)
    :ok = Pipeline.resume(p)
    joined(990, 999)

    for _ <- 1..3 do
      :ok = Store.Importer.seek(importer, 995_000_000)
      joined(995, 999)
    end

    assert Pipeline.info(p).state == :running
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "seeks while it plays at full speed: times increase, nothing is out of order, the last part is whole",
       %{tmp_dir: root} do
    path = record(root, "rec", 0..9_999)
    test = self()

    {:ok, p} =
      Pipeline.start_link(
        fn p ->
          importer = Store.importer(p, path, keep_open: true)
          send(test, {:importer, importer})

          importer
          |> Store.stream("seq")
          |> Situ.each(fn data, m -> send(test, {:got, data, m}) end)
        end,
        pipeline: [replay: [speed: :max]]
      )

    assert_receive {:importer, importer}
    got = played(100, [])

    # Without an enforced clock a stream is where its consumers let it be: every target is honoured all the same.
    targets = [50, 9_000, 20, 5_000, 10]
    for target <- targets, do: :ok = Store.Importer.seek(importer, target * 1_000_000)
    got = whole(played(9_999, got))
    # Every step is the next message, or a seek.
    jumps = for [{b, _}, {a, _}] <- Enum.chunk_every(got, 2, 1, :discard), b != a + 1, do: b
    assert hd(jumps) == 10 and jumps -- targets == []
    times = got |> Enum.map(&elem(&1, 1)) |> Enum.reverse()
    assert times == times |> Enum.sort() |> Enum.uniq()
    assert {:ok, _} = Pipeline.stop(p)
  end

  # What comes up to and with `data`, the latest first.
  defp played(data, got) do
    assert_receive {:got, now, m}
    got = [{now, m.originating_time} | got]
    if now == data, do: got, else: played(data, got)
  end

  # The end may have been that of an earlier seek, or of the play before them all: the last one's has 10 to 9,999 before
  # it, and does not come from 9.
  defp whole(got) do
    {last, [{before, _} | _]} = Enum.split(got, 9_990)

    if Enum.map(last, &elem(&1, 0)) == Enum.to_list(9_999..10//-1) and before != 9,
      do: got,
      else: whole(played(9_999, got))
  end

  test "several stores on one clock, in order of time across them at real speed", %{tmp_dir: root} do
    a = record(root, "a", 0..49)
    b = record(root, "b", 100..149)

    test = self()

    {:ok, report} =
      Pipeline.run(fn p ->
        for path <- [a, b], do: p |> Store.importer(path) |> Store.stream("seq") |> collect(test)
      end)

    assert [first, second] = Enum.map(report.result, &received/1)
    assert {length(first), length(second)} == {50, 50}
  end

  test "a loop starts over with later times", %{tmp_dir: root} do
    path = record(root, "rec", 0..4)
    test = self()

    {:ok, p} =
      Pipeline.start_link(
        fn p ->
          p
          |> Store.importer(path, loop: 10_000_000)
          |> Store.stream("seq")
          |> Situ.each(fn data, m -> send(test, {:got, data, m.originating_time}) end)
        end,
        pipeline: [replay: [interval: {0, 22_000_000}, speed: :max]]
      )

    assert {:ok, _} = Pipeline.await(p, 30_000)

    for round <- 0..1, n <- 0..4 do
      time = round * 10_000_000 + n * 1_000_000
      assert_received {:got, ^n, ^time}
    end

    for n <- 0..2, do: assert_received({:got, ^n, _})
    refute_received {:got, _, _}
  end

  test "a reader follows a live store, in memory too, and ends with its writer", %{tmp_dir: root} do
    for root <- [root, nil] do
      {:ok, writer} =
        if root,
          do: Store.Writer.create("live", root),
          else: Store.Writer.create("live", Store.Volatile.root())

      {:ok, stream} = Store.Writer.stream(writer, "seq", type: :integer)
      test = self()

      {:ok, p} =
        Pipeline.start_link(fn p ->
          p
          |> Store.importer(writer.path)
          |> Store.stream("seq")
          |> Situ.each(&send(test, {:got, &1}))
        end)

      stream =
        for i <- 1..30, reduce: stream do
          stream ->
            {:ok, stream} = Store.Writer.append(stream, [message(i, i, i, i)])
            if rem(i, 10) == 0, do: assert_receive({:got, ^i})
            stream
        end

      {:ok, _} = Store.Writer.close_stream(stream, 30)
      :ok = Store.Writer.close(writer)
      assert {:ok, _} = Pipeline.await(p, 30_000)
      for i <- 1..9, do: assert_received({:got, ^i})
      Store.delete(writer.path)
    end
  end

  test "a store written by another operating system process is followed, and its death ends it",
       %{tmp_dir: root} do
    code = """
    {:ok, writer} = Situ.Store.Writer.create("other", #{inspect(root)})
    {:ok, stream} = Situ.Store.Writer.stream(writer, "seq", type: :integer)
    IO.puts("ready")

    Enum.reduce_while(Stream.cycle([1]), {stream, 1}, fn _, {stream, i} ->
      case IO.gets("") do
        "more\\n" ->
          message = %Situ.Message{data: i, originating_time: i, creation_time: i, sequence_id: i}
          {:ok, stream} = Situ.Store.Writer.append(stream, [message])
          {:cont, {stream, i + 1}}

        _ ->
          {:halt, :ok}
      end
    end)
    """

    paths = :code.get_path() |> Enum.map(&to_string/1) |> Enum.filter(&(&1 =~ "/lib/situ"))
    args = Enum.flat_map(paths, &["-pa", &1]) ++ ["-e", code]
    elixir = System.find_executable("elixir")
    port = Port.open({:spawn_executable, elixir}, [:binary, :exit_status, line: 80, args: args])
    {:os_pid, os_pid} = Port.info(port, :os_pid)
    assert_receive {^port, {:data, {:eol, "ready"}}}, 20_000
    test = self()

    {:ok, p} =
      Pipeline.start_link(fn p ->
        p
        |> Store.importer(Path.join(root, "other"))
        |> Store.stream("seq")
        |> Situ.each(&send(test, {:got, &1}))
      end)

    for i <- 1..5 do
      Port.command(port, "more\n")
      assert_receive {:got, ^i}
    end

    {_, 0} = System.cmd("kill", ["-9", "#{os_pid}"])
    assert_receive {^port, {:exit_status, 137}}
    assert {:ok, _} = Pipeline.await(p, 30_000)

    assert %{closed?: false, live?: false} =
             root |> Path.join("other") |> Store.open!() |> Store.info()
  end

  test "errors in build say what is wrong", %{tmp_dir: root} do
    path = record(root, "rec", 0..3)

    open = fn name, opts ->
      Pipeline.run(fn p -> p |> Store.importer(path) |> Store.stream(name, opts) end)
    end

    assert {:error, %{code: :no_stream}} = open.("sek", [])
    assert {:error, %{code: :schema_mismatch}} = open.("seq", type: :string)
    assert {:ok, _} = open.("sek", or_empty: true)
    assert {:ok, _} = open.("seq", type: :number)

    assert {:error, %{code: :stream_exists}} =
             Pipeline.run(fn p ->
               exporter = Store.create(p, "twice", root)
               stream = Situ.from_enumerable(p, [{1, 1}])
               stream |> Store.write(exporter, "x") |> Store.write(exporter, "x")
             end)
  end

  test "a pipeline that could not be built leaves no recording of nothing", %{tmp_dir: root} do
    kept = record(root, "walk", 1..3)

    build = fn p ->
      p |> Situ.range(0, 3, 1_000) |> Store.write(Store.create(p, "walk", root), "N")
      raise "no camera"
    end

    assert {:error, %{code: :build_failed}} = Pipeline.run(build)
    assert Store.newest("walk", root) == kept
    test = self()

    {pid, monitor} =
      spawn_monitor(fn ->
        p = Pipeline.new()
        p |> Situ.range(0, 3, 1_000) |> Store.write(Store.create(p, "walk", root), "N")
        send(test, {:pipeline, p.pid})
        receive do: (:go -> :ok)
      end)

    pipeline = receive do: ({:pipeline, pipeline} -> Process.monitor(pipeline))
    assert Store.newest("walk", root) != kept
    send(pid, :go)
    receive do: ({:DOWN, ^monitor, :process, ^pid, _} -> :ok)
    receive do: ({:DOWN, ^pipeline, :process, _, _} -> :ok)
    assert Store.newest("walk", root) == kept
  end

  test "the keys of a stream's maps are kept in its metadata", %{tmp_dir: root} do
    maps = for i <- 1..100, do: {i * 1_000, if(i == 50, do: :none, else: %{rem(i, 7) => i})}

    {:ok, report} =
      Pipeline.run(fn p ->
        store = Store.create(p, "keys", root)

        p
        |> Situ.from_enumerable(maps)
        |> Store.write(store, "Faces", keys: true, metadata: %{"unit" => "px"})

        p |> Situ.from_enumerable([{1_000, 1}]) |> Store.write(store, "Numbers", keys: true)
        store.writer.path
      end)

    store = Store.open!(report.result)
    assert Store.closed?(store)

    assert Store.metadata(store, "Faces") ==
             {:ok, %{"unit" => "px", "keys" => Enum.to_list(0..6)}}

    assert {:error, %{code: :no_metadata}} = Store.metadata(store, "Numbers")
    assert Store.count(store, "Faces") == 100
  end

  test "a loop shorter than the recording is refused when it is built", %{tmp_dir: root} do
    path = record(root, "rec", 0..99)
    build = fn p -> p |> Store.importer(path, loop: 99_000_000) |> Store.stream("seq") end
    assert {:error, %{code: :bad_option, why: why}} = Pipeline.run(build)
    assert why =~ "99.0 ms"
  end

  test "a failing pipeline leaves a whole, closed store", %{tmp_dir: root} do
    {:error, _} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, "failing", root)

        p
        |> Situ.from_enumerable(for(i <- 1..100, do: {i * 1_000, i}))
        |> Store.write(exporter, "in")
        |> Situ.map(fn n -> if n == 60, do: raise("no"), else: n end)
        |> Store.write(exporter, "out")
      end)

    store = Store.open!(Path.join(root, "failing"))
    assert %{closed?: true, damage: []} = Store.info(store)
    out = store |> Store.messages("out") |> Enum.map(& &1.data)
    assert out == Enum.take(1..100, length(out))
  end

  test "a message that cannot be stored stops the pipeline and names the stream", %{tmp_dir: root} do
    {:error, error} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, "bad", root)

        p
        |> Situ.from_enumerable([{1, 1}, {2, self()}])
        |> Store.write(exporter, "pids")
      end)

    assert Exception.message(error) =~ "process id"
  end
end
