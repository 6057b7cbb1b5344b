defmodule Situ.Lifecycle.DrainRestartTest do
  # A component whose process is killed after all sources have ended, while messages still wait for it or in it, starts
  # again: its consumers receive every message exactly once, in order.
  use ExUnit.Case, async: true

  import Situ.Test.Eventually

  alias Situ.{Delivery, Pipeline}

  @moduletag :capture_log
  @count 400
  @stops [0, 1, 60, 150, 397, 398, 399]

  defmodule Pass do
    use Situ.Component, inputs: [in: :any], outputs: [out: :any]

    @impl true
    def handle_message(:in, message, _context, state),
      do: {[{:out, message.originating_time, message.data}], state}
  end

  # Runs a source, what `build` makes of it, and two sinks. Whenever the slower sink waits, at each of the `@stops`,
  # `kill` is called once the pipeline is ending. Returns what the sinks have received, and the result.
  defp run(build, kill, opts \\ []) do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          stream = build.(p)
          Situ.each(stream, &send(me, {:fast, {&1, &2.sequence_id}}), async: true)
          policy = opts[:policy] || Delivery.unlimited()
          Situ.each(stream, &receive_slowly(me, &1, &2), async: true, policy: policy)
        end,
        pipeline: [max_restarts: 1_000, replay: [speed: :max]]
      )

    run = Task.async(fn -> Pipeline.await(p) end)
    at_stop = if opts[:early?], do: kill, else: &kill_while_ending(&1, kill)
    {result, received} = collect({run.ref, p}, fn -> at_stop.(p) end, [])
    values = Enum.group_by(received, &elem(&1, 0), &elem(&1, 1))
    {Enum.reverse(values[:fast] || []), Enum.reverse(values[:slow] || []), result}
  end

  defp kill_while_ending(p, kill) do
    eventually(fn -> Pipeline.state(p) == :stopping end)
    kill.(p)
  end

  defp receive_slowly(test, value, message) do
    send(test, {:slow, {value, message.sequence_id}})

    if value in @stops do
      send(test, {:waiting, self()})
      receive do: (:go_on -> :ok)
    end
  end

  defp collect({ended, p} = run, kill, received) do
    receive do
      {:waiting, sink} ->
        kill.()
        send(sink, :go_on)
        collect(run, kill, received)

      {sink, _value} = message when sink in [:fast, :slow] ->
        collect(run, kill, [message | received])

      {^ended, result} ->
        {result, received}
    after
      5_000 ->
        flunk("no end after #{length(received)} messages: #{inspect(:sys.get_state(p).life)}")
    end
  end

  defp kill(p, path) do
    case List.keyfind(Supervisor.which_children(p), path, 0) do
      {^path, pid, _, _} when is_pid(pid) -> Process.exit(pid, :kill)
      _ended -> :ok
    end
  end

  defp source(p, opts \\ []), do: Situ.from_enumerable(p, 0..(@count - 1), [every: 1] ++ opts)

  defp assert_complete({fast, slow, result}) do
    assert {:ok, report} = result
    assert report.errors == []
    assert Enum.find(report.snapshot.nodes, &(&1.path == "Killed")).restarts > 0
    expected = for value <- 0..(@count - 1), do: {value, value + 1}
    assert {fast -- expected, expected -- fast} == {[], []}
    assert {slow -- expected, expected -- slow} == {[], []}
    assert {fast, slow} == {expected, expected}

    for edge <- report.snapshot.edges,
        do: assert(%{emitted: n, processed: n, dropped: 0} = edge)
  end

  @killed [name: "Killed", on_error: :restart]
  # With `throttle(2)` before the sink, messages wait in the outputs of the killed component after its inputs have
  # closed. In the other graphs, they wait at its input.
  @policies [unlimited: [], throttled: [policy: Delivery.throttle(2)]]

  for {name, opts} <- @policies do
    test "a component killed while the pipeline drains loses nothing (sink: #{name})" do
      opts = unquote(Macro.escape(opts))
      assert_complete(run(&Situ.via(source(&1), Pass, @killed), &kill(&1, "Killed"), opts))
    end

    test "a chain killed while the pipeline drains loses nothing (sink: #{name})" do
      opts = unquote(Macro.escape(opts))
      build = &Situ.map(source(&1), fn value -> value end, [async: true] ++ @killed)
      assert_complete(run(build, fn p -> kill(p, "Killed") end, opts))
    end

    test "a component with operators in its process loses nothing (sink: #{name})" do
      opts = unquote(Macro.escape(opts))

      build = fn p ->
        source(p)
        |> Situ.via(Pass, @killed)
        |> Situ.map(& &1, policy: Delivery.synchronous(), on_error: :restart)
      end

      assert_complete(run(build, &kill(&1, "Killed"), opts))
    end
  end

  # The source ends after its consumers have requested its last messages.
  test "a source that is killed before all its messages are sent produces the rest again" do
    opts = [policy: Delivery.throttle(2), early?: true]
    assert_complete(run(&source(&1, @killed), &kill(&1, "Killed"), opts))
  end

  test "a component killed after a stop by hand loses nothing" do
    stop_and_kill = fn p ->
      if Pipeline.state(p) == :running, do: spawn(fn -> Pipeline.stop(p) end)
      eventually(fn -> Pipeline.state(p) == :stopping end)
      kill(p, "Killed")
    end

    build = &Situ.via(source(&1), Pass, @killed)
    assert_complete(run(build, stop_and_kill, policy: Delivery.throttle(2), early?: true))
  end

  test "components that are not neighbours and are killed in turn lose nothing" do
    build = fn p ->
      source(p)
      |> Situ.via(Pass, name: "First", on_error: :restart)
      |> Situ.via(Pass, name: "Second", on_error: :restart)
      |> Situ.via(Pass, @killed)
    end

    kill_one = fn p ->
      n = Process.get(:kills, 0)
      Process.put(:kills, n + 1)
      kill(p, if(rem(n, 2) == 0, do: "First", else: "Killed"))
    end

    assert_complete(run(build, kill_one, policy: Delivery.throttle(2)))
  end

  defmodule Merge do
    # Passes the messages of `in` on, and reports the inputs that close.
    use Situ.Component,
      inputs: [in: :any, short: :any],
      outputs: [out: :any],
      options: [to: [type: :pid]]

    @impl true
    def handle_message(:in, message, _context, opts),
      do: {[{:out, message.originating_time, message.data}], opts}

    def handle_message(:short, _message, _context, opts), do: {[], opts}

    @impl true
    def handle_closed(input, _time, _context, opts) do
      send(opts[:to], {:closed, self(), input})
      {[], opts}
    end
  end

  test "a restarted component receives the end of an input that had closed before" do
    me = self()

    build = fn p ->
      merge = Pipeline.add(p, Merge, [to: me] ++ @killed)
      Pipeline.connect(source(p), merge, :in)
      Pipeline.connect(Situ.from_enumerable(p, [0], every: 1), merge, :short)
      Situ.Node.output(merge, :out)
    end

    assert_complete(run(build, &kill(&1, "Killed")))
    closed = collect_closed([])
    assert length(closed) >= 2
    [{last, _} | _] = closed
    assert Enum.sort(for {^last, input} <- closed, do: input) == [:in, :short]
  end

  defp collect_closed(closed) do
    receive do
      {:closed, pid, input} -> collect_closed([{pid, input} | closed])
    after
      0 -> closed
    end
  end
end
