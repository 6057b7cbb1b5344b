defmodule Situ.Dataset.OpenSessionTest do
  use ExUnit.Case, async: true
  import Situ.Dataset.Test.Study
  alias Situ.Dataset.{Importer, OpenSession, Partition, Session}
  alias Situ.Pipeline

  @moduletag :tmp_dir

  setup %{tmp_dir: root} do
    a = record(root, "a", %{"Level" => ten(0), "Only" => ten(0)})
    b = record(root, "b", %{"Level" => ten(5), "[A]:Only" => ten(0)})
    session = Session.new("p1")
    {:ok, session} = Session.add_partition(session, Partition.new("A", a))
    {:ok, session} = Session.add_partition(session, Partition.new("B", b))

    {:ok, session} =
      Session.add_partition(session, Partition.new("Gone", Path.join(root, "gone.0000")))

    %{session: session}
  end

  defp values(messages), do: Enum.map(messages, & &1.data)

  test "finds a stream by name, or by partition if it is ambiguous", %{session: session} do
    open = OpenSession.open(session)
    assert [{"Gone", %{code: :no_store}}] = open.troubles

    assert {:error, %{code: :ambiguous_stream, fix: fix}} =
             OpenSession.fetch_stream(open, "Level")

    assert fix =~ "[A]:Level" and fix =~ "[B]:Level"
    {:ok, messages} = OpenSession.messages(open, "[B]:Level", from: 6_000_000_000)
    assert values(messages) == Enum.to_list(1..9)
    assert {:ok, {"A", _, "Only"}} = OpenSession.fetch_stream(open, "Only")
    # Partition B has a stream whose name looks like an address in A.
    assert {:error, %{code: :ambiguous_stream}} = OpenSession.fetch_stream(open, "[A]:Only")
    assert {:ok, {"B", _, "[A]:Only"}} = OpenSession.fetch_stream(open, "[B]:[A]:Only")
    assert {:error, %{code: :no_partition}} = OpenSession.fetch_stream(open, "[C]:Level")
    assert {:error, %{code: :no_store}} = OpenSession.fetch_stream(open, "[Gone]:Level")
    assert {:error, %{code: :no_stream, fix: fix}} = OpenSession.fetch_stream(open, "Levl")
    assert fix =~ "Level"
    assert OpenSession.shortest_address(open, "A", "Only") == "Only"
    assert OpenSession.shortest_address(open, "A", "Level") == "[A]:Level"
    assert length(OpenSession.list_streams(open)) == 4
  end

  test "opens its streams in a pipeline", %{session: session} do
    test = self()

    {:ok, report} =
      Pipeline.run(fn p ->
        importer = Importer.open(p, session)
        refute Importer.has_stream?(importer, "Level")
        {:ok, _} = Importer.partition_importer(importer, "A")
        {:error, %{code: :no_store}} = Importer.partition_importer(importer, "Gone")

        importer
        |> Importer.stream("[A]:Level")
        |> Situ.join(Importer.stream(importer, "[B]:Level"))
        |> Situ.each(&send(test, {:pair, &1}))

        importer
        |> Importer.stream("Nothing", or_empty: true)
        |> Situ.each(&send(test, {:pair, &1}))
      end)

    assert report.errors == []
    pairs = for _ <- 1..5, do: receive(do: ({:pair, pair} -> pair))
    assert pairs == for(i <- 0..4, do: {i + 5, i})
    refute_received {:pair, _}

    assert {:error, %{code: :ambiguous_stream}} =
             Pipeline.run(fn p ->
               p |> Importer.open(session) |> Importer.stream("Level", or_empty: true)
             end)
  end
end
