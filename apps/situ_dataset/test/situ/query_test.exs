defmodule Situ.QueryTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Annotation, Expression, Query}
  alias Situ.Annotation.{Layer, Recording, Schema}
  alias Situ.Dataset.{OpenSession, Partition, Session}
  alias Situ.Dataset.Test.Study

  @moduletag :tmp_dir

  defp open(stores) do
    session =
      Enum.reduce(stores, Session.new("s"), fn {name, path}, session ->
        {:ok, session} = Session.add_partition(session, Partition.new(name, path))
        session
      end)

    OpenSession.open(session)
  end

  defp series,
    do:
      map(list(integer(1, 60)), fn times ->
        for t <- Enum.sort(Enum.uniq(times)), do: {t, rem(t * 7, 5)}
      end)

  # Evaluates the latest messages at every instant from the first message to the last.
  defp by_instants([], []), do: []

  defp by_instants(a, b) do
    times = Enum.map(a ++ b, &elem(&1, 0))
    expression = Expression.parse!("A > 1 and B < 3 or A == 0")

    true_at =
      for t <- Enum.min(times)..Enum.max(times), into: %{} do
        {t, Expression.eval(expression, %{"A" => latest(a, t), "B" => latest(b, t)})}
      end

    {open, found} =
      Enum.reduce(Enum.min(times)..Enum.max(times), {nil, []}, fn t, {open, found} ->
        case {open, true_at[t]} do
          {nil, true} -> {t, found}
          {from, false} when from != nil -> {nil, [{from, t} | found]}
          _ -> {open, found}
        end
      end)

    Enum.reverse(if open, do: [{open, Enum.max(times)} | found], else: found)
  end

  defp latest(items, t),
    do: items |> Enum.take_while(&(elem(&1, 0) <= t)) |> List.last({0, nil}) |> elem(1)

  property "finds the same intervals as an evaluation at every instant",
    numtests: 60,
    context: %{tmp_dir: root} do
    forall {a, b} <- {series(), series()} do
      a = if a == [], do: [{1, 4}], else: a
      b = if b == [], do: [{1, 4}], else: b
      path = Study.record(root, "r", %{"A" => a, "B" => b})
      {:ok, found} = Query.run(open([{"P", path}]), "A > 1 and B < 3 or A == 0")
      Situ.Store.delete(path)
      assert found.intervals == by_instants(a, b)
    end
  end

  test "applies minimum lengths, joins, holds and limits", %{tmp_dir: root} do
    on = fn t -> {t, true} end
    off = fn t -> {t, false} end

    path =
      Study.record(root, "r", %{
        "vad" => [on.(10), off.(20), on.(22), off.(30), on.(50), off.(51), on.(90)],
        "Room.Level" => [{1, 0.5}, {95, 0.5}]
      })

    session = open([{"Room", path}])
    run = fn source, opts -> elem(Query.run(session, source, opts), 1) end
    assert run.("vad", []).intervals == [{10, 20}, {22, 30}, {50, 51}, {90, 90}]
    assert run.("vad", least: 2).intervals == [{10, 20}, {22, 30}]
    assert run.("vad", join: 2).intervals == [{10, 30}, {50, 51}, {90, 90}]
    assert run.("vad", hold: 5).intervals == [{10, 15}, {22, 27}, {50, 51}, {90, 95}]
    assert run.("vad", from: 15, to: 25).intervals == [{15, 20}, {22, 22}]
    assert %{intervals: [{10, 20}], truncated?: true} = run.("vad", limit: 1)

    assert run.("`Room.Level` > 0 and vad", []).intervals == [
             {10, 20},
             {22, 30},
             {50, 51},
             {90, 95}
           ]

    assert run.("`[Room]:vad` and latency(vad) == 1000", []).intervals ==
             run.("vad", []).intervals

    assert run.("age(vad) >= 40 and `Room.Level` > 0", []).intervals == []
    assert {:error, %{code: :no_stream}} = Query.run(session, "vod")
    assert {:error, %{code: :constant}} = Query.run(session, "1 < 2")
    assert {:error, %{code: :bad_expression}} = Query.run(session, "vad and")
  end

  test "reads annotations as maps of the tracks that have one", %{tmp_dir: root} do
    schema = Schema.finite("Speech", ["speaks", "laughs"])
    item = &Annotation.new(&1, &2, &3, %{"Speech" => &4})

    {:ok, layer} =
      Layer.new(schema, [
        item.(10, 20, "P1", "speaks"),
        item.(15, 30, "P2", "laughs"),
        item.(20, 40, "P1", "laughs")
      ])

    {:ok, _} = Recording.write(layer, Path.join(root, "annotation"), "Speech")
    path = Study.record(root, "room", %{"Level" => [{1, 0}, {18, 5}, {25, 0}, {99, 0}]})
    session = open([{"A", Path.join(root, "annotation")}, {"R", path}])
    {:ok, found} = Query.run(session, "Speech.P1.Speech == 'laughs'")
    assert found.intervals == [{20, 40}]
    {:ok, found} = Query.run(session, "'P1' in Speech and 'P2' in Speech and Level > 1")
    assert found.intervals == [{18, 25}]

    assert [%{proposed?: true, from: 18, to: 25, values: %{"Note" => "both"}}] =
             Query.annotations(found, "Found", %{"Note" => "both"})
  end

  test "stops a query that takes too long", %{tmp_dir: root} do
    items = for i <- 1..50_000, do: {i, rem(i, 2)}
    session = open([{"R", Study.record(root, "r", %{"A" => items})}])
    assert {:error, %{code: :timeout}} = Query.run(session, "A == 1", timeout: 1)
    {:ok, found} = Query.run(session, "A == 1", limit: 10)
    assert length(found.intervals) == 10
  end
end
