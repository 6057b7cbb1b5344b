defmodule Situ.Store.NativeFormatTest do
  # Reads stores while they are being written, by this VM and by another operating system process.
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.{Pipeline, Store}
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  test "a reader follows a live store and ends with its writer", %{tmp_dir: root} do
    for root <- [root, nil] do
      {:ok, writer} =
        if root,
          do: Store.Writer.create("live", root),
          else: Store.Writer.create("live", Store.MemoryStores.root_folder())

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

  test "a reader follows a store written by another OS process, and ends when that process dies",
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

  test "thousands of requests wait for one store in one thread", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("wait", root)
    {:ok, stream} = Writer.stream(writer, "N", type: :integer)
    store = Store.open!(writer.path)
    known = Store.info(store).entries
    threads = fn -> length(File.ls!("/proc/self/task")) end
    before = threads.()
    for tag <- 1..2_000, do: :ok = Store.notify(store, known, tag)
    # Other tests run their own threads.
    assert threads.() - before < 20
    {:ok, _} = Writer.append(stream, messages([1]))
    for tag <- 1..2_000, do: assert_receive({:situ_store, ^tag, {:published, _}}, 2_000)
    :ok = Writer.close(writer)
    # A commit that already happened is reported immediately.
    :ok = Store.notify(store, known, 1)
    assert_receive {:situ_store, 1, {:published, n}} when n > known
  end
end
