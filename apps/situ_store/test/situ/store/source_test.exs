defmodule Situ.Store.SourceTest do
  # Importers that seek during playback.
  use ExUnit.Case, async: true
  import Situ.Store.Test.Play
  import Situ.Store.Test.Record
  alias Situ.{Pipeline, Store}

  @moduletag :tmp_dir

  test "pauses, steps, seeks and resumes", %{tmp_dir: root} do
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

  # Starts a player of two streams, paused at 0.
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

  # Receives the joined messages with recorded times from `from` to `to` ms, and returns their pipeline times.
  defp joined(from, to) do
    for i <- from..to do
      assert_receive {:got, {^i, ^i}, m}
      # Latency always stays that of the recording.
      assert m.creation_time >= m.originating_time
      m.originating_time
    end
  end

  test "a seek backward starts a new epoch for all streams of the importer", %{tmp_dir: root} do
    {p, importer} = player(root, [])
    :ok = Store.Importer.seek(importer, 500_000_000)
    [at] = joined(500, 500)
    # After a seek past all delivered messages, pipeline time is recorded time.
    assert at == 500_000_000
    assert {:ok, 501_000_000} = Store.Importer.step(importer)
    [at] = joined(501, 501)

    :ok = Store.Importer.seek(importer, 100_000_000)
    [back] = joined(100, 100)
    assert back > at
    assert Store.Importer.position(importer) == 100_000_000
    # Within the epoch, time differences are those of the recording.
    assert {:ok, 101_000_000} = Store.Importer.step(importer)
    assert joined(101, 101) == [back + 1_000_000]
    refute_received {:got, {102, _}, _}
    :ok = Store.Importer.seek(importer, 900_000_000)
    assert joined(900, 900) == [back + 800_000_000]

    # Seeks several times, also to before the beginning.
    for target <- [3, 700, 2, -5, 0, 998] do
      :ok = Store.Importer.seek(importer, target * 1_000_000)
      if target >= 0, do: assert([_] = joined(target, target))
    end

    :ok = Pipeline.set_speed(p, 1_000.0)
    :ok = Pipeline.resume(p)
    assert [_] = joined(999, 999)
    assert {:ok, _} = Pipeline.await(p, 30_000)
  end

  test "a player with keep_open: true waits at its end for a seek", %{tmp_dir: root} do
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

  test "after seeks at full speed, times still increase and the last part is complete",
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

    # At maximum speed, the position depends on the consumers, but every seek must still take effect.
    targets = [50, 9_000, 20, 5_000, 10]
    for target <- targets, do: :ok = Store.Importer.seek(importer, target * 1_000_000)
    got = whole(played(9_999, got))
    # Each message is followed by the next one, or by the target of a seek.
    jumps = for [{b, _}, {a, _}] <- Enum.chunk_every(got, 2, 1, :discard), b != a + 1, do: b
    assert hd(jumps) == 10 and jumps -- targets == []
    times = got |> Enum.map(&elem(&1, 1)) |> Enum.reverse()
    assert times == times |> Enum.sort() |> Enum.uniq()
    assert {:ok, _} = Pipeline.stop(p)
  end

  # The end may belong to an earlier seek or to the initial playback. After the last seek come messages 10 to 9,999,
  # and the message before them is not 9.
  defp whole(got) do
    case Enum.split(got, 9_990) do
      {last, [{before, _} | _]} when before != 9 -> if last?(last), do: got, else: more(got)
      _ -> more(got)
    end
  end

  defp last?(last), do: Enum.map(last, &elem(&1, 0)) == Enum.to_list(9_999..10//-1)
  defp more(got), do: whole(played(9_999, got))
end
