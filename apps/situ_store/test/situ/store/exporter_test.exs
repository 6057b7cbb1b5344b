defmodule Situ.Store.ExporterTest do
  # Stores written by pipelines, and errors that stop them.
  use ExUnit.Case, async: true
  import Situ.Store.Test.Play
  alias Situ.{Pipeline, Store}

  @moduletag :tmp_dir

  test "an error for misordered arguments shows the right order", %{tmp_dir: root} do
    Pipeline.run(fn p ->
      for args <- [["x", p, root], [p, :x, root], [p, "x", :here], [p, "x", root, :fast]] do
        error = assert_raise ArgumentError, fn -> apply(Store, :create, args) end
        assert error.message =~ ~s|Situ.Store.create(p, "lobby", "recordings")|
      end

      store = Store.create(p, "x", root)
      numbers = Situ.from_enumerable(p, 1..2, every: 1)

      for args <- [[store, numbers, "N"], [numbers, "N", store], [numbers, store, :n]] do
        error = assert_raise ArgumentError, fn -> apply(Store, :write, args) end
        assert error.message =~ "Situ.Store.write/4 takes a stream"
      end

      Store.write(numbers, store, "N")
    end)
  end

  test "one pipeline records, and another replays the same messages", %{tmp_dir: root} do
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

  test "recording loses nothing under a lossy default policy", %{tmp_dir: root} do
    {:ok, report} =
      Pipeline.run(
        fn p ->
          exporter = Store.create(p, "lossy", root)
          p |> Situ.from_enumerable(0..19_999, every: 1_000) |> Store.write(exporter, "all")
          exporter.path
        end,
        pipeline: [default_policy: Situ.Delivery.latest()]
      )

    assert [%{count: 20_000}] = report.result |> Store.open!() |> Store.streams()
  end

  test "a pipeline that fails to build leaves no empty recording", %{tmp_dir: root} do
    kept = record(root, "walk", 1..3)

    build = fn p ->
      p
      |> Situ.from_enumerable(0..2, every: 1_000)
      |> Store.write(Store.create(p, "walk", root), "N")

      raise "no camera"
    end

    assert {:error, %{code: :build_failed}} = Pipeline.run(build)
    assert Store.newest("walk", root) == kept
    test = self()

    {pid, monitor} =
      spawn_monitor(fn ->
        p = Pipeline.new()

        p
        |> Situ.from_enumerable(0..2, every: 1_000)
        |> Store.write(Store.create(p, "walk", root), "N")

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

  test "accepts nil for an optional stream or recording", %{tmp_dir: root} do
    {:ok, _} =
      Pipeline.run(fn p ->
        store = Store.create(p, "some", root)
        assert Store.write(nil, store, "Absent") == nil
        numbers = Situ.from_enumerable(p, 1..3, every: 10)
        assert Store.write(numbers, nil, "Unrecorded") == numbers
        Store.write(numbers, store, "N")
      end)

    assert ["N"] = Enum.map(Store.streams(Store.open!(Path.join(root, "some"))), & &1.name)
  end

  test "an error for an unknown option suggests the nearest one", %{tmp_dir: root} do
    assert {:error, %Situ.Error{code: :unknown_option, fix: fix}} =
             Pipeline.run(fn p ->
               store = Store.create(p, "typo", root)

               Store.write(Situ.from_enumerable(p, 1..3, every: 10), store, "N", compresion: :zstd)
             end)

    assert fix =~ ":compression"
  end
end
