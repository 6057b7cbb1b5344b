defmodule Situ.Lifecycle.RedeliveryTest do
  # A component whose process is killed receives again what it had not handled, and emits nothing twice: its consumers
  # receive every message once, in order.
  use ExUnit.Case, async: true

  alias Situ.{Delivery, Pipeline}

  @moduletag :capture_log
  @count 4_000
  # A pipeline whose sources have completed restarts nothing.
  @stops Enum.take_every(100..2_500, 200)

  defmodule Pass do
    use Situ.Component, inputs: [in: :any], outputs: [out: :any]

    @impl true
    def handle_message(:in, message, _context, state),
      do: {[{:out, message.originating_time, message.data}], state}
  end

  # Runs a source, what `build` makes of it, and two sinks; kills the process of `path` while the slower sink waits at
  # each of the `@stops`. Returns what both sinks have received, and the report.
  defp run(path, build) do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          stream = build.(p)
          Situ.each(stream, &send(me, {:fast, {&1, &2.sequence_id}}), async: true)

          Situ.each(stream, &receive_slowly(me, &1, &2), async: true, policy: Delivery.throttle(2))
        end,
        pipeline: [max_restarts: 1_000, replay: [speed: :max]]
      )

    run = Task.async(fn -> Pipeline.await(p) end)
    {report, received} = collect(run.ref, fn -> kill(p, path) end, [])
    values = Enum.group_by(received, &elem(&1, 0), &elem(&1, 1))
    {Enum.reverse(values.fast), Enum.reverse(values.slow), report}
  end

  defp receive_slowly(test, value, message) do
    send(test, {:slow, {value, message.sequence_id}})

    if value in @stops do
      send(test, {:waiting, self()})
      receive do: (:go_on -> :ok)
    end
  end

  defp collect(ended, kill, received) do
    receive do
      {:waiting, sink} ->
        kill.()
        send(sink, :go_on)
        collect(ended, kill, received)

      {sink, _value} = message when sink in [:fast, :slow] ->
        collect(ended, kill, [message | received])

      {^ended, {:ok, report}} ->
        {report, received}
    end
  end

  defp kill(p, path) do
    case List.keyfind(Supervisor.which_children(p), path, 0) do
      {^path, pid, _, _} when is_pid(pid) -> Process.exit(pid, :kill)
      _restarting -> kill(p, path)
    end
  end

  defp source(p, opts \\ []), do: Situ.from_enumerable(p, 0..(@count - 1), [every: 1] ++ opts)

  defp restarts(report), do: Enum.find(report.snapshot.nodes, &(&1.path == "Killed")).restarts

  defp assert_complete({fast, slow, report}) do
    assert restarts(report) == length(@stops)
    assert fast == for(value <- 0..(@count - 1), do: {value, value + 1})
    assert slow == fast

    for edge <- report.snapshot.edges,
        do: assert(%{emitted: n, processed: n, dropped: 0} = edge)
  end

  for {what, opts} <- [{"default", []}, {"throttled", [policy: Delivery.throttle(3)]}] do
    test "a killed component loses nothing (#{what} policy)" do
      opts = unquote(Macro.escape(opts)) ++ [name: "Killed", on_error: :restart]
      assert_complete(run("Killed", &Situ.via(source(&1), Pass, opts)))
    end

    test "a killed chain of operators loses nothing (#{what} policy)" do
      opts = unquote(Macro.escape(opts)) ++ [name: "Killed", on_error: :restart, async: true]
      assert_complete(run("Killed", &Situ.map(source(&1), fn value -> value end, opts)))
    end
  end

  test "a killed component with operators in its process loses nothing" do
    build = fn p ->
      source(p)
      |> Situ.via(Pass, name: "Killed", on_error: :restart)
      |> Situ.map(& &1, policy: Delivery.synchronous(), on_error: :restart)
    end

    assert_complete(run("Killed", build))
  end

  test "a killed source that produces its messages again loses nothing" do
    assert_complete(run("Killed", &source(&1, name: "Killed", on_error: :restart)))
  end

  test "with on_restart: :drop, what was lost counts as dropped" do
    policy = Delivery.unlimited(on_restart: :drop)
    build = &Situ.via(source(&1), Pass, name: "Killed", on_error: :restart, policy: policy)
    {fast, slow, report} = run("Killed", build)
    assert restarts(report) > 0
    assert slow == fast
    assert fast == Enum.uniq(Enum.sort(fast))
    edge = Enum.find(report.snapshot.edges, &(&1.to_input == "in" and &1.emitted == @count))
    assert edge.dropped > 0
    assert edge.processed == length(fast)
    assert edge.processed + edge.dropped == @count
  end
end
