defmodule Situ.CLI.Store.SendingTest do
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
    :ok = Store.Writer.close(writer)
    %{path: writer.path}
  end

  test "a stream is sent when the subscriber is there, and all of it comes", %{path: path} do
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :ok = :gen_tcp.close(socket)
    address = "tcp://127.0.0.1:#{port}"
    test = self()

    {:ok, subscriber} =
      Pipeline.start(
        fn p ->
          p |> Bridge.ZeroMQ.subscribe(address, topic: "a") |> Situ.each(&send(test, {:came, &1}))
        end,
        []
      )

    argv = ["store", "send", path, "-s", "A", "-a", address, "-t", "a", "--speed", "0"]
    assert capture_io(fn -> assert Situ.CLI.run(argv) == 0 end) == ""
    for i <- 1..5, x = i / 2, do: assert_receive({:came, ^x})
    {:ok, _} = Pipeline.stop(subscriber)
  end
end
