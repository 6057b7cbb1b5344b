defmodule Situ.CLI.Store.ExchangeTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.{Bridge, Message, Pipeline, Store}

  @moduletag :tmp_dir

  setup %{tmp_dir: root} do
    {:ok, writer} = Store.Writer.create("r", root)
    {:ok, a} = Store.Writer.stream(writer, "A", type: :float)
    {:ok, _} = Store.Writer.stream(writer, "Pids", type: :any)

    messages =
      for i <- 1..5,
          do: %Message{
            data: i / 2,
            originating_time: i * 1_000,
            creation_time: i * 1_000,
            sequence_id: i
          }

    {:ok, _} = Store.Writer.append(a, messages)
    {:ok, b} = Store.Writer.stream(writer, "B", type: :integer)
    {:ok, _} = Store.Writer.append(b, for(m <- messages, do: %{m | data: m.sequence_id}))
    :ok = Store.Writer.close(writer)
    %{path: writer.path}
  end

  defp address do
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :ok = :gen_tcp.close(socket)
    "tcp://127.0.0.1:#{port}"
  end

  defp decoded(text) do
    {:ok, value} = Situ.JSON.decode(text)
    value
  end

  # Each topic's messages go to the test.
  defp subscriber(address, topics) do
    test = self()

    {:ok, subscriber} =
      Pipeline.start(
        fn p ->
          for topic <- topics do
            p
            |> Bridge.ZeroMQ.subscribe(address, topic: topic)
            |> Situ.each(&send(test, {topic, &1}))
          end
        end,
        []
      )

    on_exit(fn -> Pipeline.stop(subscriber) end)
  end

  test "waits for the subscriber, then sends the entire stream", %{path: path} do
    address = address()
    subscriber(address, ["a"])
    argv = ["store", "send", path, "-s", "A", "-a", address, "-t", "a", "--speed", "0"]
    assert capture_io(fn -> assert Situ.CLI.run(argv) == 0 end) == ""
    for i <- 1..5, x = i / 2, do: assert_receive({"a", ^x})
  end

  test "sends all streams, each on its topic, from one address", %{path: path} do
    address = address()
    # Each of the two subscribers wants one topic. Nothing is sent before both are connected.
    subscriber(address, ["lab/A", "lab/B"])
    argv = ["store", "send", path, "-a", address, "-t", "lab/", "--speed", "0", "--json"]
    argv = argv ++ ["--subscribers", "2"]

    assert %{"messages" => 10, "streams" => ["A", "B"]} =
             capture_io(fn -> assert Situ.CLI.run(argv) == 0 end) |> decoded()

    for i <- 1..5, x = i / 2, do: assert_receive({"lab/A", ^x})
    for i <- 1..5, do: assert_receive({"lab/B", ^i})
  end

  test "sends a part in a loop", %{path: path} do
    address = address()
    subscriber(address, ["A"])
    argv = ["store", "send", path, "-s", "A", "-a", address, "--speed", "0.05", "--loop"]
    argv = argv ++ ["--from", "4000"]
    sending = Task.async(fn -> capture_io(fn -> Situ.CLI.run(argv) end) end)
    for _ <- 1..3, x <- [2.0, 2.5], do: assert_receive({"A", ^x}, 20_000)
    Task.shutdown(sending, :brutal_kill)
    argv = ["store", "send", path, "--loop", "--to", "3000"]

    assert capture_io(:stderr, fn -> assert Situ.CLI.run(argv) == 2 end) =~
             "crop the recording first"
  end

  test "records the sent messages", %{path: path, tmp_dir: root} do
    address = address()
    out = Path.join(root, "came")
    argv = ["store", "record", out, "A", "B", "-a", address, "-n", "10", "--json"]

    recording = Task.async(fn -> capture_io(fn -> assert Situ.CLI.run(argv) == 0 end) end)
    sent = ["store", "send", path, "-a", address, "--speed", "0", "--subscribers", "2"]
    assert capture_io(fn -> assert Situ.CLI.run(sent) == 0 end) == ""
    assert %{"messages" => 10, "path" => came} = decoded(Task.await(recording, 30_000))
    came = Store.open!(came)
    assert [1, 2, 3, 4, 5] == came |> Store.messages("B") |> Enum.map(& &1.data)
    assert {:ok, %{data: 0.5, originating_time: 1_000}} = Store.at(came, "A", 0)
  end

  test "rejects an unknown stream, and one without messages", %{path: path} do
    for {argv, said} <- [{["-s", "Nowhere"], "Nowhere"}, {["-s", "Pids"], "no messages"}] do
      assert capture_io(:stderr, fn ->
               assert Situ.CLI.run(["store", "send", path | argv]) == 1
             end) =~
               said
    end
  end
end
