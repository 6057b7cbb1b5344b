# test/torture/run: kills recorders that split their recording with -9, while another process follows the recording.
# Every acknowledged message that is still kept must be read, once and in order, also over restarts.
# elixir -pa ... test/torture/segments.exs KILLS
defmodule Situ.SegmentTorture do
  alias Situ.Store

  # Prints the number of the last committed message of each stream. `after_commit` emits messages once they are
  # committed.
  @recorder """
  {:ok, _} = Application.ensure_all_started(:situ_store)
  root = System.get_env("TORTURE_ROOT")
  first = String.to_integer(System.get_env("TORTURE_FIRST"))
  keep = if System.get_env("TORTURE_KEEP") == "all", do: [], else: [keep: {:span, 4_000_000}]
  {:ok, _} = Situ.Pipeline.run(fn p ->
    opts = [split: 1_000_000, first_extent: 65_536, max_extent: 65_536] ++ keep
    store = Situ.Store.create(p, "hall", root, opts)
    numbers = Situ.from_enumerable(p, Stream.iterate(first, & &1 + 1), every: 1_000)
    a = Situ.Store.write(numbers, store, "a", after_commit: true)
    b = numbers |> Situ.map(&{:item, &1}) |> Situ.Store.write(store, "b", after_commit: true)
    Situ.each(a, &IO.puts("a \#{&1}"))
    Situ.each(b, fn {:item, n} -> IO.puts("b \#{n}") end)
  end, pipeline: [replay: [interval: {first * 1_000, :unbounded}, speed: :max]])
  """

  def main([kills]) do
    kills = String.to_integer(kills)
    :rand.seed(:exsss, {4, 5, 6})
    results = for n <- 1..kills, do: run_round(n)
    failed = Enum.count(results, &(&1 == :failed))
    IO.puts("#{kills - failed} passed, #{failed} failed")
    System.halt(if failed == 0, do: 0, else: 1)
  end

  # Kills two runs of a recorder. Even rounds keep everything.
  defp run_round(n) do
    root = Path.join(System.tmp_dir!(), "situ-segments-#{System.pid()}-#{n}")
    File.mkdir_p!(root)
    keep = if rem(n, 2) == 0, do: "all", else: "latest"
    followers = for name <- ["a", "b"], do: {name, follow(root, name)}
    one = record(root, 1, keep)
    two = record(root, 1_000_000, keep)
    check(root, [one, two], keep)
    for {name, task} <- followers, do: check_followed(name, Task.await(task, 60_000), keep)
    File.rm_rf!(root)
    :passed
  rescue
    error ->
      IO.puts(:stderr, "round #{n}: " <> Exception.format(:error, error, __STACKTRACE__))
      :failed
  end

  # Follows a stream of the first run until its recorder is killed.
  defp follow(root, name) do
    Task.async(fn ->
      store = await_stream(Path.join(root, "hall"), name)
      {:ok, info} = Store.stream_info(store, name)
      follow(store, info, 0, 0, [])
    end)
  end

  defp await_stream(path, name) do
    with {:ok, store} <- Store.open(path), true <- Store.has_stream?(store, name) do
      store
    else
      _ -> receive(do: (nil -> nil), after: (5 -> await_stream(path, name)))
    end
  end

  defp follow(store, info, ordinal, known, found) do
    case Store.Query.read_batch(store, info, ordinal, :unbounded, 1_000, []) do
      {:ok, [], _} ->
        Store.notify(store, known, 1)

        receive do
          {:situ_store, 1, {:published, n}} -> follow(store, info, ordinal, n, found)
          {:situ_store, 1, {:ended, _}} -> found |> Enum.reverse() |> Enum.concat()
        end

      {:ok, messages, next} ->
        follow(store, info, next, known, [Enum.map(messages, &number(&1.data)) | found])
    end
  end

  defp number({:item, n}), do: n
  defp number(n), do: n

  # A follower reads all messages in order. If segments are deleted, it may miss some, but it reads none twice. If the
  # second run begins before the follower notices the end of the first one, it also reads the second run.
  defp check_followed(name, numbers, keep) do
    {one, two} = Enum.split_while(numbers, &(&1 < 1_000_000))
    gaps = find_gaps(one, keep) ++ find_gaps(two, keep)
    late = if keep == "all", do: Enum.take(two, 1) -- [1_000_000], else: []

    if gaps != [] or late != [] do
      raise "the follower of #{name} read #{length(one)} and #{length(two)} messages of the runs; " <>
              "wrong: #{inspect(gaps, limit: 20)} #{inspect(late)}"
    end
  end

  # Returns the neighbours of which the second does not follow the first.
  defp find_gaps(numbers, keep) do
    for {a, b} <- Enum.zip(numbers, Enum.drop(numbers, 1)),
        if(keep == "all", do: b != a + 1, else: b <= a),
        do: {a, b}
  end

  defp record(root, first, keep) do
    paths = :code.get_path() |> Enum.map(&to_string/1) |> Enum.filter(&(&1 =~ "/lib/situ"))
    args = Enum.flat_map(paths, &["-pa", &1]) ++ ["-e", @recorder]

    env =
      for {key, value} <- [ROOT: root, FIRST: "#{first}", KEEP: keep],
          do: {~c"TORTURE_#{key}", to_charlist(value)}

    port =
      Port.open({:spawn_executable, System.find_executable("elixir")}, [
        :binary,
        :exit_status,
        :stderr_to_stdout,
        line: 1_000,
        args: args,
        env: env
      ])

    {:os_pid, pid} = Port.info(port, :os_pid)
    Map.merge(%{first: first}, collect(port, pid, %{}, false))
  end

  # The kill comes at a random moment after the first acknowledged message.
  defp collect(port, pid, last, started?) do
    receive do
      {^port, {:data, {_, <<name::binary-1, " ", number::binary>>}}} when name in ["a", "b"] ->
        if not started?, do: Process.send_after(self(), :kill, :rand.uniform(1_500))
        collect(port, pid, Map.put(last, name, String.to_integer(number)), true)

      {^port, {:data, {_, line}}} ->
        IO.puts(:stderr, line)
        collect(port, pid, last, started?)

      :kill ->
        System.cmd("kill", ["-9", "#{pid}"])
        collect(port, pid, last, started?)

      {^port, {:exit_status, 137}} ->
        last

      {^port, {:exit_status, status}} ->
        raise "the recorder ended with status #{status}"
    after
      60_000 -> raise "the recorder did not start"
    end
  end

  defp check(root, runs, keep) do
    path = Path.join(root, "hall")
    store = Store.open!(path)
    %{live?: false, closed?: false, damage: [], notes: []} = Store.info(store)

    for name <- ["a", "b"] do
      numbers = store |> Store.messages(name) |> Enum.map(&number(&1.data))
      for run <- runs, do: check_run(name, numbers, run, keep)

      kept =
        for s <- Store.segments(store), m <- segment_messages(s.path, name), do: number(m.data)

      true = numbers == Enum.sort(kept)
    end

    {:ok, %{damage: []}} = Store.verify(path)
    {:ok, %{dropped: 0}} = Store.repair(path)
    before = count(store)
    true = Store.closed?(Store.open!(path))
    {:ok, _} = Store.compact(path)
    {:ok, copy} = Store.copy(path, {"copy", root})
    ^before = count(Store.open!(copy))
  end

  # All acknowledged messages of a run are there from the first that is kept, and those of the second run at least for
  # the span that is kept.
  defp check_run(name, numbers, %{first: first} = run, keep) do
    mine = Enum.filter(numbers, &(&1 >= first and &1 < first + 999_999))
    true = mine == [] or mine == Enum.to_list(hd(mine)..List.last(mine))
    complete? = mine != [] and hd(mine) == first and List.last(mine) >= Map.get(run, name, 0)
    acknowledged? = mine != [] and List.last(mine) >= Map.get(run, name, 0)

    cond do
      keep == "all" -> true = complete?
      first > 1 -> true = acknowledged?
      true -> true
    end
  end

  defp segment_messages(path, name) do
    store = Store.open!(path)
    if Store.has_stream?(store, name), do: Store.messages(store, name), else: []
  end

  defp count(store), do: for(info <- Store.streams(store), do: {info.name, info.count})
end

{:ok, _} = Application.ensure_all_started(:situ_store)
Situ.SegmentTorture.main(System.argv())
