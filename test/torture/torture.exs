# test/torture/run: kills recording pipelines with -9, and opens, checks, repairs and copies their
# stores.
# elixir -pa ... test/torture/torture.exs KILLS
defmodule Situ.Torture do
  alias Situ.Store

  # The writer's script: a pipeline whose source prints the numbers of messages that are
  # committed.
  @writer """
  root = System.get_env("TORTURE_ROOT")
  {:ok, writer} = Situ.Store.Writer.create("rec", root, first_extent: 65_536, max_extent: 262_144)
  {:ok, a} = Situ.Store.Writer.stream(writer, "a", type: :integer)
  {:ok, b} = Situ.Store.Writer.stream(writer, "b", compression: :zstd)
  IO.puts("0")
  Enum.reduce(0..100_000, {a, b}, fn batch, {a, b} ->
    messages = fn value ->
      for i <- 1..20 do
        n = batch * 20 + i
        %Situ.Message{data: value.(n), originating_time: n * 1_000, creation_time: n * 1_000 + 7, sequence_id: n}
      end
    end
    {:ok, a} = Situ.Store.Writer.append(a, messages.(& &1))
    {:ok, b} = Situ.Store.Writer.append(b, messages.(&{:item, &1, String.duplicate("x", rem(&1, 50))}))
    # Opens a new stream from time to time, so that the catalog grows, too.
    if rem(batch, 200) == 100, do: {:ok, _} = Situ.Store.Writer.stream(writer, "late \#{batch}")
    IO.puts("\#{(batch + 1) * 20}")
    {a, b}
  end)
  """

  def main([kills]) do
    kills = String.to_integer(kills)
    :rand.seed(:exsss, {1, 2, 3})
    results = for n <- 1..kills, do: kill(n)
    failed = Enum.count(results, &(&1 == :failed))
    IO.puts("#{kills - failed} passed, #{failed} failed")
    System.halt(if failed == 0, do: 0, else: 1)
  end

  defp kill(n) do
    root = Path.join(System.tmp_dir!(), "situ-torture-#{System.pid()}-#{n}")
    File.mkdir_p!(root)
    acknowledged = record(root, :rand.uniform(120))
    check(Path.join(root, "rec"), acknowledged, root)
    File.rm_rf!(root)
    :passed
  rescue
    error ->
      IO.puts(:stderr, "kill #{n}: " <> Exception.format(:error, error, __STACKTRACE__))
      :failed
  end

  # Starts a writer, kills it `ms` after its first line, and returns the last number that it
  # printed.
  defp record(root, ms) do
    paths = :code.get_path() |> Enum.map(&to_string/1) |> Enum.filter(&(&1 =~ "/lib/situ"))
    args = Enum.flat_map(paths, &["-pa", &1]) ++ ["-e", @writer]

    port =
      Port.open({:spawn_executable, System.find_executable("elixir")}, [
        :binary,
        :exit_status,
        line: 100,
        args: args,
        env: [{~c"TORTURE_ROOT", String.to_charlist(root)}]
      ])

    # A shell starts the VM with exec, so this is the VM's own process.
    {:os_pid, pid} = Port.info(port, :os_pid)

    receive do
      {^port, {:data, {:eol, "0"}}} -> :ok
    after
      60_000 -> raise "the writer did not start"
    end

    Process.send_after(self(), :kill, ms)
    collect(port, pid, 0)
  end

  defp collect(port, pid, last) do
    receive do
      {^port, {:data, {:eol, line}}} -> collect(port, pid, String.to_integer(line))
      {^port, {:data, {:noeol, _}}} -> collect(port, pid, last)
      :kill -> System.cmd("kill", ["-9", "#{pid}"]) && collect(port, pid, last)
      {^port, {:exit_status, 137}} -> last
      {^port, {:exit_status, status}} -> raise "the writer ended with status #{status}"
    end
  end

  defp check(path, acknowledged, root) do
    store = Store.open!(path)
    %{live?: false, closed?: false, damage: []} = Store.info(store)
    a = values(store, "a")
    b = values(store, "b")
    true = length(a) >= acknowledged and length(b) >= acknowledged
    ^a = Enum.to_list(1..length(a)//1)
    true = b == for(n <- 1..length(b)//1, do: {:item, n, String.duplicate("x", rem(n, 50))})
    {:ok, %{damage: []}} = Store.verify(path)
    {:ok, %{dropped: 0}} = Store.repair(path)
    true = path |> Store.open!() |> Store.closed?()
    {:ok, copy} = Store.copy(path, {"copy", root})
    ^a = copy |> Store.open!() |> values("a")
  end

  defp values(store, name), do: store |> Store.messages(name) |> Enum.map(& &1.data)
end

{:ok, _} = Application.ensure_all_started(:situ_store)
Situ.Torture.main(System.argv())
