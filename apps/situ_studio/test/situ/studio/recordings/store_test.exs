defmodule Situ.Studio.Recordings.StoreTest do
  # Draws recordings on disk: nothing that they do not contain, at any zoom level and on any
  # system.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  import Situ.Studio.Asking, only: [ask: 2, json: 1]
  alias Situ.Store.Writer
  alias Situ.Studio.{DataSession, StreamInfo, StreamOverview, StreamReader, Recordings}

  @moduletag :tmp_dir

  defp record(dir, name, type, rows) do
    {:ok, writer} = Writer.create(name, dir)
    {:ok, out} = Writer.stream(writer, "S", type: type)

    messages =
      for {{t, data}, i} <- Enum.with_index(rows),
          do: %Situ.Message{data: data, originating_time: t, creation_time: t, sequence_id: i}

    {:ok, out} = Writer.append(out, messages)
    {:ok, _} = Writer.close_stream(out, elem(List.last(rows), 0))
    :ok = Writer.close(writer)
    writer.path
  end

  defp source(path) do
    {:ok, source} = Recordings.Store.open(path)
    source
  end

  # Returns the segments in times of the recording.
  defp lanes(source, from, to, px) do
    {reply, _} =
      ask(DataSession.new(source), %{
        "open" => [[1, %{"stream" => "S", "viz" => "states"}]],
        "series" => [
          [1, Integer.to_string(from), Integer.to_string(to), max(div(to - from, px), 1)]
        ]
      })

    [%{kind: 2, payload: payload, base: base}] = reply.frames
    for [a, b | rest] <- json(payload), do: {base + a, b && base + b, rest}
  end

  # Returns a boolean every 10 ms that keeps its value for random runs of 1 to 2,000 messages.
  defp runs(n) do
    :rand.seed(:exsss, {1, 2, n})

    Stream.repeatedly(fn -> round(:math.pow(2_000, :rand.uniform())) end)
    |> Enum.reduce_while({[], 0, true}, fn run, {rows, i, value} ->
      rows = Enum.reduce(i..(i + run - 1), rows, &[{&1 * 10_000_000, value} | &2])
      if i + run > n, do: {:halt, Enum.reverse(rows)}, else: {:cont, {rows, i + run, not value}}
    end)
  end

  test "draws states exactly or as many, in any window of 50,000 messages", %{
    tmp_dir: dir
  } do
    rows = runs(50_000)
    source = source(record(dir, "runs", :boolean, rows))
    truth = List.to_tuple(Enum.map(rows, &elem(&1, 1)))
    last = elem(List.last(rows), 0)

    windows =
      forall {a, w} <- {:proper_types.integer(0, last), :proper_types.integer(1, 9)} do
        from = a
        to = min(last, a + div(last, Integer.pow(4, w)))
        bin = max(div(max(to - from, 1), 800), 1)

        for {a, b, [label, class]} when class in ["true", "false"] <- lanes(source, from, to, 800) do
          assert label == class
          # A bin at either end may contain the change itself.
          first = ceil(max(a, from) + 2 * bin) |> div(10_000_000) |> Kernel.+(1)
          stop = div(min(b || last, to) - 2 * bin, 10_000_000) - 1

          for i <- first..stop//max(div(stop - first, 50), 1), i < tuple_size(truth) do
            assert elem(truth, i) == (label == "true")
          end
        end
      end

    Situ.Test.Property.check_forall(windows, numtests: 60)
  end

  test "draws a state that changes with every message as many", %{tmp_dir: dir} do
    rows = for i <- 0..9_999, do: {i * 10_000_000, rem(i, 2) == 0}
    rows = rows ++ for i <- 10_000..10_999, do: {i * 10_000_000, true}

    assert [{0, until, [label, "many"]}, {until, nil, ["true", "true"]}] =
             lanes(source(record(dir, "flicker", :boolean, rows)), 0, 109_990_000_000, 800)

    assert_in_delta until, 100_000_000_000, 150_000_000
    assert label =~ ~r/\A\d+ messages: \d+ (true|false), \d+ (true|false)\z/
  end

  test "draws maps of states and numbers from the summary, too", %{tmp_dir: dir} do
    rows = for i <- 0..20_000, do: {i * 1_000_000, %{on: i > 10_000, level: i / 1}}
    source = source(record(dir, "maps", {:map, :atom, :any}, rows))
    on = for {a, _, [label, _, "on"]} <- lanes(source, 0, 20_000_000_000, 800), do: {a, label}
    assert [{0, "false"} | changes] = on
    assert {changed, "true"} = List.last(changes)
    assert_in_delta changed, 10_001_000_000, 25_000_000
  end

  test "a gap in a regular stream is empty in a lane", %{tmp_dir: dir} do
    rows = for i <- Enum.concat(0..499, 1_200..1_999), do: {i * 10_000_000, true}
    source = source(record(dir, "hole", :boolean, rows))

    assert [{0, until, ["true", "true"]}, {later, nil, ["true", "true"]}] =
             lanes(source, 0, 19_990_000_000, 800)

    assert until in 4_990_000_000..5_100_000_000
    assert_in_delta later, 12_000_000_000, 25_000_000
  end

  test "describes the damage of an external file in sentences", %{tmp_dir: dir} do
    path = Path.join(dir, "walk.csv")
    File.write!(path, "time,x\n0,1\nnever,2\n1,3\n")
    {:ok, recording} = Situ.Store.open(path)

    assert [damage] = StreamReader.list_damage(recording)
    assert damage =~ "never"
  end

  test "returns the nearest messages on both sides", %{tmp_dir: dir} do
    times = for i <- 1..2_500, do: i * 10 + rem(i * i, 7)
    source = source(record(dir, "near", :float, for(t <- times, do: {t, t * 1.0})))

    same =
      forall {time, n} <-
               {:proper_types.integer(-5, 25_100), :proper_types.integer(1, 40)} do
        read = fn side ->
          for m <- StreamReader.list_neighbours(source, "S", side, time, n),
              do: m.originating_time
        end

        assert read.(:before) ==
                 times |> Enum.filter(&(&1 < time)) |> Enum.take(-n) |> Enum.reverse()

        assert read.(:after) == times |> Enum.filter(&(&1 > time)) |> Enum.take(n)
      end

    Situ.Test.Property.check_forall(same, numtests: 100)
    assert StreamReader.list_neighbours(source, "Nothing", :before, 5, 3) == []
  end

  test "a gap that extends beyond the window is empty there, too", %{tmp_dir: dir} do
    rows = for i <- Enum.concat(0..4_999, 20_000..24_999), do: {i * 1_000_000, true}
    source = source(record(dir, "wide", :boolean, rows))
    # With so many messages, the summary is drawn.
    assert [{0, until, ["true", "true"]}] = lanes(source, 0, 10_000_000_000, 800)
    assert_in_delta until, 5_000_000_000, 30_000_000
    shown = lanes(source, 10_000_000_000, 25_000_000_000, 800)
    refute Enum.any?(shown, fn {a, b, _} -> a < 19_970_000_000 and b > 10_000_000_000 end)
    assert {_, nil, ["true", "true"]} = List.last(shown)
  end

  test "a message between two gaps leaves both empty at any zoom level", %{tmp_dir: dir} do
    rows = for i <- Enum.concat([0..199, [300], 500..699]), do: {i * 1_000_000, true}
    source = source(record(dir, "lone", :boolean, rows))

    for {from, to} <- [{0, 700}, {190, 520}, {290, 310}, {301, 302}, {250, 251}, {400, 505}] do
      for {a, b, _} <- lanes(source, from * 1_000_000, to * 1_000_000, 800) do
        for hole <- [250_000_000, 400_000_000], do: refute(a < hole and (b == nil or b > hole))
      end
    end
  end

  test "draws an atom that this system does not know as a state", %{tmp_dir: dir} do
    type = {:in, [:situ_test_idle, :situ_test_moving]}
    atom = "situ_never_seen_#{System.unique_integer([:positive])}"
    path = record(dir, "atoms", type, for(i <- 0..9, do: {i * 1_000_000_000, atom}))
    assert [{0, nil, [^atom, "state"]}] = lanes(source(path), 0, 9_000_000_000, 800)
  end

  test "reports a recording that was replaced under its name", %{tmp_dir: dir} do
    path = record(dir, "again", :boolean, [{0, true}, {1_000, false}])
    source = source(path)
    assert {:ok, [%StreamInfo{count: 2}]} = StreamOverview.list_streams(source)
    File.rm_rf!(path)
    record(dir, "other", :float, for(i <- 0..9, do: {i, 1.0}))
    File.rename!(Path.join(dir, "other.0000"), path)
    :ets.delete(source.state.cache, :look)
    assert {:error, %{code: :replaced}} = StreamReader.fetch_extent(source)
  end
end
