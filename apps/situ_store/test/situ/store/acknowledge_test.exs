defmodule Situ.Store.AcknowledgeTest do
  # Events of a message queue are acknowledged when they are in a recording: no acknowledged event is missing after a
  # kill, and all others are delivered again.
  use ExUnit.Case, async: true

  alias Situ.{GenStage, Pipeline, Store}
  alias Situ.Store.Test.Queue

  @moduletag :tmp_dir
  @moduletag :capture_log

  @doc false
  def record(queue, root, opts \\ [], write_options \\ []) do
    fn p ->
      store = Store.create(p, "work", root, opts)
      events = GenStage.from(p, queue, subscribe: [max_demand: 60])

      done =
        events
        |> Situ.map(& &1.data, async: true)
        |> Store.write(store, "Numbers", [after_commit: true] ++ write_options)

      GenStage.acknowledge(events, done)
    end
  end

  # The numbers in all versions of the recording.
  defp recorded(root) do
    for path <- Path.wildcard(Path.join(root, "work.*")),
        {:ok, store} <- [Store.open(path)],
        Store.has_stream?(store, "Numbers"),
        message <- Store.messages(store, "Numbers"),
        into: MapSet.new(),
        do: message.data
  end

  defp await_empty(queue) do
    if Queue.left(queue) > 0 do
      Process.sleep(5)
      await_empty(queue)
    end
  end

  test "the returned messages are in the recording when they arrive", %{tmp_dir: root} do
    me = self()

    for {name, opts} <- [whole: [], synced: [durability: :each], parts: [split: 1_000_000]] do
      assert {:ok, _} =
               Pipeline.run(fn p ->
                 store = Store.create(p, "#{name}", root, opts)

                 p
                 |> Situ.from_enumerable(for(i <- 1..2_000, do: {i * 1_000, i}))
                 |> Store.write(store, "Numbers", after_commit: true)
                 |> Situ.each(fn n ->
                   if rem(n, 500) == 1 and name != :parts do
                     {:ok, open} = Store.open(store.path)
                     send(me, {name, n, Store.count(open, "Numbers") >= n})
                   end

                   send(me, {name, n})
                 end)
               end)

      for n <- 1..2_000, do: assert_received({^name, ^n})
      for n <- 1..2_000//500, name != :parts, do: assert_received({^name, ^n, true})
    end
  end

  test "after kills of the pipeline, no acknowledged event is missing", %{tmp_dir: root} do
    file = Path.join(root, "acknowledged")
    {:ok, queue} = Queue.start(Enum.to_list(1..3_000), file)

    for round <- 1..15 do
      {:ok, p} = Pipeline.start(record(queue, root), [])
      monitor = Process.monitor(p)
      Process.sleep(rem(round * 11, 17))
      Process.exit(p, :kill)
      assert_receive {:DOWN, ^monitor, _, _, _}
      acknowledged = MapSet.new(Queue.acknowledged(file))
      assert MapSet.subset?(acknowledged, recorded(root))
    end

    {:ok, p} = Pipeline.start(record(queue, root), [])
    await_empty(queue)
    assert {:ok, _} = Pipeline.stop(p)
    assert Queue.acknowledged(file) |> Enum.uniq() |> Enum.sort() == Enum.to_list(1..3_000)
    assert recorded(root) == MapSet.new(1..3_000)
  end

  test "a writer that is killed and restarted writes every event once", %{tmp_dir: root} do
    file = Path.join(root, "acknowledged")
    {:ok, queue} = Queue.start(Enum.to_list(1..3_000), file)
    options = [on_error: :restart, name: "Writer"]
    {:ok, p} = Pipeline.start(record(queue, root, [], options), pipeline: [max_restarts: 1_000])

    for _ <- 1..20 do
      with {:ok, {pid, _}} <- GenStage.subscription(p, "Writer"), do: Process.exit(pid, :kill)
      Process.sleep(5)
    end

    await_empty(queue)
    assert {:ok, _} = Pipeline.stop(p)
    store = root |> Path.join("work") |> Store.open!()
    assert store |> Store.messages("Numbers") |> Enum.map(& &1.data) == Enum.to_list(1..3_000)
  end

  test "after kills of the system, no acknowledged event is missing", %{tmp_dir: root} do
    file = Path.join(root, "acknowledged")
    # More than a busy machine acknowledges before it is killed.
    all = Enum.to_list(1..400_000)

    for round <- 1..3 do
      left = all -- Queue.acknowledged(file)
      File.write!(Path.join(root, "left"), :erlang.term_to_binary(left))
      kill_system(root, round * 15)
      acknowledged = MapSet.new(Queue.acknowledged(file))
      assert MapSet.size(acknowledged) > 0
      assert MapSet.subset?(acknowledged, recorded(root))
    end

    refute Queue.acknowledged(file) |> Enum.uniq() |> length() == length(all)
  end

  # Runs the pipeline in another system and kills that with SIGKILL, `ms` after its first acknowledgement.
  defp kill_system(root, ms) do
    paths = for path <- :code.get_path(), path = to_string(path), path =~ "_build", do: path
    paths = paths ++ [Path.dirname(to_string(:code.which(Enum)))]
    file = Path.join(root, "acknowledged")
    before = length(Queue.acknowledged(file))

    code = ~s"""
    IO.puts(System.pid())
    {:ok, _} = Application.ensure_all_started(:situ_store)
    root = #{inspect(root)}
    left = root |> Path.join("left") |> File.read!() |> :erlang.binary_to_term()
    {:ok, queue} = Situ.Store.Test.Queue.start(left, Path.join(root, "acknowledged"))
    Code.require_file(#{inspect(__ENV__.file)})
    {:ok, _} = Situ.Pipeline.start(Situ.Store.AcknowledgeTest.record(queue, root), [])
    Process.sleep(:infinity)
    """

    code = "ExUnit.start(autorun: false)\n" <> code
    script = Path.join(root, "run.exs")
    File.write!(script, code)
    args = Enum.flat_map(paths, &["-pa", &1]) ++ [script]
    elixir = System.find_executable("elixir")
    port = Port.open({:spawn_executable, elixir}, [:binary, :exit_status, line: 100, args: args])
    assert_receive {^port, {:data, {:eol, pid}}}, 60_000
    await_acknowledged(file, before)
    Process.sleep(ms)
    {_, 0} = System.cmd("kill", ["-9", pid])
    assert_receive {^port, {:exit_status, _}}, 60_000
  end

  defp await_acknowledged(file, before) do
    if length(Queue.acknowledged(file)) == before do
      Process.sleep(5)
      await_acknowledged(file, before)
    end
  end
end
