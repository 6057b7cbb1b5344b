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

  test "a stream as a file of each format, and the file read back", %{path: path, tmp_dir: root} do
    for {ending, format} <- [csv: :csv, json: :json, jsonl: :json_lines, msgpack: :message_pack] do
      file = Path.join(root, "a.#{ending}")

      assert capture_io(fn ->
               assert Situ.CLI.run(["store", "save", path, file, "-s", "A"]) == 0
             end) == ""

      read = Enum.to_list(Bridge.File.messages(file, format))
      assert Enum.map(read, &elem(&1, 0)) == for(i <- 1..5, do: i * 1_000)
      refute File.exists?(file <> ".unfinished")
    end
  end

  test "which stream, which format, where to: told when it is not clear", %{
    path: path,
    tmp_dir: root
  } do
    for {argv, status, said} <- [
          {[path, Path.join(root, "x.csv")], 1, "A, Pids"},
          {[path, Path.join(root, "x.doc"), "-s", "A"], 2, "format"},
          {[path, Path.join(root, "no/x.csv"), "-s", "A"], 1, "cannot write"},
          {[path, Path.join(root, "x.csv"), "-s", "B"], 1, "no stream"}
        ] do
      assert capture_io(:stderr, fn -> assert Situ.CLI.run(["store", "save" | argv]) == status end) =~
               said
    end
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
