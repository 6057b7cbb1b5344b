defmodule Situ.Bench.Recover do
  # A writer in another process records 1 GB and is killed with -9. Measures the time to open the
  # store again, and to repair it.
  alias Situ.Store

  def tests, do: [{"recover", &recover/1}]

  defp recover(scale) do
    root = Path.join(System.tmp_dir!(), "situ-bench-recover-#{System.pid()}")
    File.rm_rf!(root)
    File.mkdir_p!(root)
    n = max(1, round(10_000 * scale))

    try do
      write_and_die(root, n)
      started = :erlang.monotonic_time(:nanosecond)
      store = Store.open!(Path.join(root, "killed"))
      {:ok, info} = Store.stream_info(store, "s")
      {:ok, _} = Store.at(store, info, -1)
      opened = :erlang.monotonic_time(:nanosecond) - started
      if info.count != n * 1_000, do: raise("#{info.count} messages, not #{n * 1_000}")
      started = :erlang.monotonic_time(:nanosecond)
      {:ok, %{damage: []}} = Store.repair(Path.join(root, "killed"))
      repaired = :erlang.monotonic_time(:nanosecond) - started

      bytes =
        root |> Path.join("**") |> Path.wildcard() |> Enum.map(&File.stat!(&1).size) |> Enum.sum()

      [
        {"recover", opened / 1.0e6, "ms"},
        {"recover_repair", repaired / 1.0e6, "ms"},
        {"recover_size", bytes / 1.0e6, "MB"}
      ]
    after
      File.rm_rf!(root)
    end
  end

  defp write_and_die(root, n) do
    code = """
    {:ok, writer} = Situ.Store.Writer.create("killed", #{inspect(root)})
    {:ok, stream} = Situ.Store.Writer.stream(writer, "s", type: :binary)
    data = :binary.copy("x", 100)
    Enum.reduce(0..#{n - 1}, stream, fn batch, stream ->
      messages = for i <- 1..1000 do
        time = (batch * 1000 + i) * 1000
        %Situ.Message{data: data, originating_time: time, creation_time: time, sequence_id: batch * 1000 + i}
      end
      {:ok, stream} = Situ.Store.Writer.append(stream, messages)
      stream
    end)
    System.cmd("kill", ["-9", System.pid()])
    """

    paths = :code.get_path() |> Enum.map(&to_string/1) |> Enum.filter(&(&1 =~ "/lib/situ"))
    args = Enum.flat_map(paths, &["-pa", &1]) ++ ["-e", code]
    {_, status} = System.cmd("elixir", args, stderr_to_stdout: true)
    if status != 137, do: raise("the writer ended with status #{status}")
  end
end
