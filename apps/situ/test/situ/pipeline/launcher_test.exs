defmodule Situ.Pipeline.LauncherTest do
  # A failure while a pipeline starts is always returned as an error; the start never hangs.
  use ExUnit.Case, async: true

  alias Situ.Fixture.Count
  alias Situ.Pipeline

  @moduletag :capture_log

  defmodule Mine do
    # Runs a given function in a callback.
    use Situ.Component, outputs: [out: :any], options: [init: [type: :any], start: [type: :any]]

    @impl true
    def init(opts) do
      with fun when is_function(fun, 0) <- opts[:init], do: fun.()
      {:ok, opts[:start]}
    end

    @impl true
    def handle_start(context, start) do
      with fun when is_function(fun, 0) <- start, do: fun.()
      {[{:complete, context.start_time}], start}
    end
  end

  defp die, do: Process.exit(self(), :kill)
  defp mine(opts), do: fn p -> Situ.source(p, Mine, opts) end

  # Starts in every possible way; a linked caller must survive to report.
  defp each_way(build, settings \\ []) do
    Process.flag(:trap_exit, true)
    opts = [pipeline: settings]

    [
      Pipeline.run(build, opts),
      with({:ok, pid} <- Pipeline.start(build, opts), do: Pipeline.await(pid, 30_000)),
      with({:ok, pid} <- Pipeline.start_link(build, opts), do: Pipeline.await(pid, 30_000))
    ]
  end

  defp codes(results), do: Enum.map(results, fn {:error, %Situ.Error{code: code}} -> code end)

  test "returns an error if the process dies in build" do
    assert codes(each_way(fn _p -> die() end)) == [:crashed, :crashed, :crashed]
  end

  test "returns an error if the process crashes between build and the first source" do
    broken = %Situ.Clock{kind: :broken}
    results = each_way(fn p -> Situ.source(p, Count) end, clock: broken)
    assert codes(results) == [:crashed, :crashed, :crashed]
  end

  test "returns an error if a :run handler raises, exits, throws or is killed" do
    for {wrong, code} <- [
          {fn _ -> raise "no" end, :handler_failed},
          {fn _ -> exit(:no) end, :handler_failed},
          {fn _ -> throw(:no) end, :handler_failed}
        ] do
      build = fn p ->
        Situ.source(p, Count)
        Pipeline.on(p, :run, wrong)
      end

      assert codes(each_way(build)) == [code, code, code]
    end

    killed = fn p ->
      Situ.source(p, Count)
      Pipeline.on(p, :run, fn _ -> die() end)
    end

    assert {:error, %{code: :crashed}} = Pipeline.run(killed)
  end

  test "returns an error if a component dies in init/1 or handle_start/2" do
    for callback <- [:init, :start],
        do: assert(codes(each_way(mine([{callback, &die/0}]))) == List.duplicate(killed(), 3))
  end

  defp killed, do: :component_killed

  test "a component that hangs in init/1 or handle_start/2 does not block a stop" do
    me = self()
    hang = fn -> send(me, :hangs) && receive(do: (:never -> :ok)) end

    for callback <- [:init, :start] do
      {:ok, p} = Pipeline.start(mine([{callback, hang}]), pipeline: [stop_timeout: 50])
      assert_receive :hangs
      assert {:error, %{code: :stuck, what: what}} = Pipeline.stop(p)
      assert what =~ "Mine"
    end
  end

  test "nothing is started if the caller ends before the build is done" do
    me = self()

    for start <- [&Pipeline.start/2, &Pipeline.start_link/2, &Pipeline.run/2] do
      build = fn p ->
        send(me, {:building, self()})
        receive do: (:build -> :ok)
        Situ.source(p, Mine, init: fn -> send(me, :started) end)
      end

      caller = spawn(fn -> start.(build, []) end)
      assert_receive {:building, pipeline}
      ref = Process.monitor(pipeline)
      Process.exit(caller, :kill)
      caller_gone(caller)
      send(pipeline, :build)
      assert_receive {:DOWN, ^ref, :process, ^pipeline, _}
      refute_received :started
    end
  end

  defp caller_gone(pid) do
    ref = Process.monitor(pid)
    assert_receive {:DOWN, ^ref, :process, ^pid, _}
  end

  test "a crash of the running pipeline process returns an error to all waiting callers" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: 1_000_000_000)
          |> Situ.each(fn _ -> send(me, {:component, self()}) end)
        end,
        []
      )

    assert_receive {:component, component}
    ref = Process.monitor(component)
    waiter = Task.async(fn -> Pipeline.await(p) end)
    :ok = waits(p)
    # No stage ever reports this event.
    send(p, {:situ_stage, 1, {:nonsense}})
    assert {:error, %{code: :crashed}} = Task.await(waiter, 30_000)
    assert_receive {:DOWN, ^ref, :process, ^component, _}
  end

  # Waits until the waiter's request has arrived.
  defp waits(p) do
    case :sys.get_state(p) do
      %{waiters: [_ | _]} -> :ok
      _ -> waits(p)
    end
  end
end
