defmodule Situ.Bridge.NamesTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge

  @moduletag :tmp_dir

  test "every streaming bridge has a source and a sink" do
    for module <- [
          Bridge.File,
          Bridge.Mqtt,
          Bridge.Protobuf.File,
          Bridge.Ros,
          Bridge.Ros2,
          Bridge.ServerSentEvents,
          Bridge.Tcp,
          Bridge.WebSocket,
          Bridge.ZeroMQ
        ] do
      exported = Code.ensure_loaded!(module).__info__(:functions) |> Keyword.keys()
      assert :source in exported and :sink in exported, inspect(module)
    end
  end

  test "source and sink work like the named functions", %{tmp_dir: dir} do
    path = Path.join(dir, "x.csv")
    values = [{0, 1.5}, {1_000_000_000, 2.5}]

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        p |> Situ.from_enumerable(values) |> Bridge.File.sink(path, format: :csv)
      end)

    assert Situ.to_list(&Bridge.File.source(&1, path, format: :csv), times: true) == values
    me = self()

    {:ok, sender} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Situ.from_enumerable(values)
        |> Bridge.ZeroMQ.sink("tcp://127.0.0.1:0", wait_for: 1, listening: me)
      end)

    assert_receive {:listening, port}, 5_000

    {:ok, receiver} =
      Situ.Pipeline.start_link(fn p ->
        p |> Bridge.ZeroMQ.source("tcp://127.0.0.1:#{port}") |> Situ.each(&send(me, {:got, &1}))
      end)

    for {_, value} <- values, do: assert_receive({:got, ^value}, 10_000)
    for pipeline <- [sender, receiver], do: Situ.Pipeline.stop(pipeline)
  end
end
