defmodule Situ.Lifecycle.RestartTest do
  # A restarted component continues where its predecessor stopped: sequence ids and times keep increasing, and
  # messages that a source produces again are not emitted twice.
  use ExUnit.Case, async: true

  alias Situ.Fixture.Count
  alias Situ.{Clock, Pipeline, Time}

  @moduletag :capture_log

  defmodule Flaky do
    # Counts to nine; raises before emitting five, but only the first time.
    use Situ.Component, outputs: [out: :integer], options: [tries: [type: :any]]

    @impl true
    def init(opts), do: {:ok, {opts[:tries], 0}}

    @impl true
    def handle_demand(_n, context, {tries, 9}),
      do: {[{:out, context.start_time + 9, 9}, {:complete, context.start_time + 9}], {tries, 10}}

    def handle_demand(_n, _context, {_tries, 10} = state), do: {[], state}

    def handle_demand(_n, context, {tries, n}) do
      if n == 5 and :counters.get(tries, 1) == 0 do
        :counters.add(tries, 1, 1)
        raise "flaky"
      end

      {[{:out, context.start_time + n, n}], {tries, n + 1}}
    end
  end

  defp told(stream, me),
    do: Situ.each(stream, fn v, m -> send(me, {:got, v, m.sequence_id}) end, async: true)

  # Returns the process of a component; waits until it differs from `before`.
  defp process(p, path, before \\ nil) do
    found =
      Enum.find_value(:sys.get_state(p).stages, fn {_, stage} ->
        Enum.any?(stage.vertices, &(&1.path == path)) && stage.pid
      end)

    if found == before, do: process(p, path, before), else: found
  end

  defp kill(p, path) do
    pid = process(p, path)
    Process.exit(pid, :kill)
    process(p, path, pid)
  end

  for {what, behind} <- [
        {"a source", quote(do: & &1)},
        {"a source with operators in its process",
         quote(do: &Situ.map(&1, fn v -> v end, policy: Situ.Delivery.synchronous()))}
      ] do
    test "#{what} emits every message once after a kill, with continuing numbers" do
      me = self()
      clock = Clock.manual(0)

      {:ok, p} =
        Pipeline.start(
          fn p ->
            p
            |> Situ.source(Count, count: :infinity, interval: Time.ms(10), on_error: :restart)
            |> unquote(behind).()
            |> told(me)
          end,
          pipeline: [clock: clock]
        )

      assert Pipeline.clock(p) == clock
      Clock.set(clock, Time.ms(55))
      for n <- 0..5, do: assert_receive({:got, ^n, id} when id == n + 1)
      kill(p, "Count")
      Clock.set(clock, Time.ms(105))
      for n <- 6..10, do: assert_receive({:got, ^n, id} when id == n + 1)
      refute_received {:got, _, _}
      assert {:ok, _} = Pipeline.stop(p)
    end
  end

  test "a killed chain of operators continues its numbering" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1))
          |> Situ.map(& &1, on_error: :restart)
          |> told(me)
        end,
        []
      )

    assert_receive {:got, _, _}
    kill(p, "Map")
    drain()
    assert_receive {:got, _, last}
    # Few messages are lost, and none arrives twice.
    assert last > 1
    assert {:ok, _} = Pipeline.stop(p)
    ids = [last | drain()]
    assert ids == Enum.uniq(Enum.sort(ids))
  end

  defp drain do
    receive do
      {:got, _, id} -> [id | drain()]
    after
      0 -> []
    end
  end

  test "a source that raises halfway emits every message once, with continuing numbers" do
    me = self()

    assert {:ok, report} =
             Pipeline.run(fn p ->
               p
               |> Situ.source(Flaky, tries: :counters.new(1, []), on_error: :restart)
               |> told(me)
             end)

    assert report.skipped == %{"Flaky" => 1}
    assert drain() == Enum.to_list(1..10)
  end

  test "an importer's messages keep their own numbers" do
    me = self()

    replay = fn ->
      for n <- 1..9,
          do: %Situ.Message{
            data: n,
            originating_time: n * 10,
            creation_time: n,
            sequence_id: n * 100
          }
    end

    tries = :counters.new(1, [])

    assert {:ok, _} =
             Pipeline.run(fn p ->
               p
               |> Situ.source(__MODULE__.Replay,
                 messages: replay.(),
                 tries: tries,
                 on_error: :restart
               )
               |> told(me)
             end)

    assert drain() == for(n <- 1..9, do: n * 100)
  end

  defmodule Replay do
    # Forwards messages one by one; fails once in the middle.
    use Situ.Component,
      outputs: [out: :any],
      options: [messages: [type: :list], tries: [type: :any]]

    @impl true
    def init(opts), do: {:ok, {opts[:messages], opts[:tries]}}

    @impl true
    def handle_demand(_n, _context, {[], _} = state), do: {[], state}

    def handle_demand(_n, _context, {[message | rest], tries}) do
      if message.data == 5 and :counters.get(tries, 1) == 0 do
        :counters.add(tries, 1, 1)
        raise "flaky"
      end

      done = if rest == [], do: [{:complete, message.originating_time}], else: []
      {[{:out, message} | done], {rest, tries}}
    end
  end
end
