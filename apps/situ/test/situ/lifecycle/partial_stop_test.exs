defmodule Situ.Lifecycle.PartialStopTest do
  # Stops a composite or a component while the rest of its pipeline keeps running.
  use ExUnit.Case, async: true
  import Situ.Test.Eventually

  alias Situ.Fixture.Count
  alias Situ.{Clock, Pipeline, Time}

  @moduletag :capture_log

  defmodule Tell do
    # Forwards its input and reports every event to the test.
    use Situ.Component,
      inputs: [in: :any],
      outputs: [out: :any],
      options: [as: [type: :atom], to: [type: :pid]]

    @impl true
    def init(opts), do: {:ok, {opts[:as], opts[:to]}}

    @impl true
    def handle_message(:in, message, _context, {as, to} = state) do
      send(to, {as, message.data})
      {[{:out, message.originating_time, message.data}], state}
    end

    @impl true
    def handle_closed(:in, time, _context, {as, to} = state) do
      send(to, {as, :closed, time})
      {[], state}
    end

    @impl true
    def terminate(reason, {as, to}), do: send(to, {as, :terminated, reason})
  end

  # Emits a number every 10 ms; "Side" doubles the numbers and has a consumer outside.
  defp start(settings \\ []) do
    me = self()

    Pipeline.start(
      fn p ->
        numbers = Situ.source(p, Count, count: :infinity, interval: Time.ms(10))
        Situ.via(numbers, Tell, as: :main, to: me, name: "Main")

        numbers
        |> Situ.composite("Side", fn numbers ->
          p = numbers.pipeline

          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(10))
          |> Situ.via(Tell, as: :own, to: me, name: "Own")

          numbers
          |> Situ.map(&(&1 * 2), name: "Double")
          |> Situ.via(Tell, as: :side, to: me, name: "Inner")
          |> Situ.map(&(&1 + 1), name: "Last")
        end)
        |> Situ.via(Tell, as: :outside, to: me, name: "Outside")
        |> Situ.via(Tell, as: :next, to: me, name: "Next")
      end,
      pipeline: settings
    )
  end

  defp states(p), do: Map.new(Pipeline.info(p).nodes, &{&1.path, &1.state})

  defp receive_all(as, values), do: for(v <- values, do: assert_receive({^as, ^v}))

  test "a composite handles messages in flight, closes at the stop time and ends while the rest runs" do
    clock = Clock.manual(0)
    {:ok, p} = start(clock: clock)
    assert Pipeline.clock(p) == clock
    Clock.set(clock, Time.ms(105))
    for as <- [:own, :main], do: receive_all(as, 0..10)
    receive_all(:side, for(n <- 0..10, do: n * 2))
    assert :ok = Pipeline.stop_part(p, "Side")
    receive_all(:outside, for(n <- 0..10, do: n * 2 + 1))
    closed = Time.ms(105)
    for as <- [:own, :side, :outside], do: assert_receive({^as, :closed, ^closed})
    for as <- [:own, :side], do: assert_receive({^as, :terminated, :normal})

    Clock.set(clock, Time.ms(200))
    receive_all(:main, 11..20)
    refute_received {:own, _}
    refute_received {:side, _}
    refute_received {:outside, :terminated, _}

    # Components outside keep running; a component without any open input has nothing more to emit.
    assert_receive {:next, :closed, ^closed}

    states = states(p)

    for path <- ~w(Side.Count Side.Own Side.Double Side.Inner Side.Last),
        do: assert(states[path] == :closed)

    for path <- ~w(Count Main), do: assert(states[path] == :running)

    # These close by themselves: the pipeline learns of a closed input only after the component has handled it.
    assert eventually(fn -> match?(%{"Next" => :closed, "Outside" => :closed}, states(p)) end)

    assert {:ok, report} = Pipeline.stop(p)
    assert_receive {:outside, :terminated, :normal}
    assert report.errors == []

    # Outside components may close with the part if it was their last input; the rest closes with the pipeline.
    {first, rest} = Enum.split(report.closed, 7)
    assert Enum.count(first, &String.starts_with?(&1, "Side.")) == 5
    assert Enum.sort(rest) == ["Count", "Main"]
  end

  test "stops a component by its path, and its consumers see the end of the stream" do
    {:ok, p} = start()
    assert_receive {:outside, _}
    assert :ok = Pipeline.stop_part(p, "Side.Inner")
    assert_receive {:side, :terminated, :normal}
    assert_receive {:own, _}
    assert :ok = Pipeline.stop_part(p, "Side")
    assert_receive {:own, :terminated, :normal}
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "refuses unknown, stopped and shared components" do
    {:ok, p} = start()
    assert {:error, %{code: :unknown_component, fix: fix}} = Pipeline.stop_part(p, "Sied")
    assert fix =~ "Side"
    assert :ok = Pipeline.stop_part(p, "Side")
    assert {:error, %{code: :not_running}} = Pipeline.stop_part(p, "Side")
    {:ok, _} = Pipeline.stop(p)
    assert {:error, %{code: :not_running}} = Pipeline.stop_part(p, "Side")

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.composite("Box", fn p ->
            p |> Situ.source(Count, count: :infinity, interval: Time.ms(1)) |> Situ.map(& &1)
          end)
          |> Situ.map(& &1, name: "Behind", policy: Situ.Delivery.synchronous())
        end,
        []
      )

    assert {:error, %{code: :shared_process, what: what}} = Pipeline.stop_part(p, "Box")
    assert what =~ "Box.Map" and what =~ "Behind"
    {:ok, _} = Pipeline.stop(p)
  end

  test "a pipeline ends without its last sources and continues without an unfinished finite one" do
    build = fn others ->
      fn p ->
        Situ.composite(p, "Part", fn p ->
          p |> Situ.source(Count, count: 1_000_000, interval: Time.ms(10)) |> Situ.each(& &1)
        end)

        for n <- 1..others//1 do
          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(10), name: "Other#{n}")
          |> Situ.each(& &1)
        end
      end
    end

    {:ok, alone} = Pipeline.start(build.(0), [])
    assert :ok = Pipeline.stop_part(alone, "Part")
    assert {:ok, %{errors: []}} = Pipeline.await(alone, 30_000)

    {:ok, p} = Pipeline.start(build.(1), [])
    assert :ok = Pipeline.stop_part(p, "Part")
    assert Pipeline.state(p) == :running
    assert {:ok, _} = Pipeline.stop(p)
  end

  # Starts a pipeline whose "Part" blocks at its first message until the test lets it continue.
  defp standing(settings) do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          numbers = Situ.source(p, Count, count: :infinity, interval: Time.ms(1))
          Situ.via(numbers, Tell, as: :main, to: me)

          Situ.composite(numbers, "Part", fn numbers ->
            Situ.each(
              numbers,
              fn v ->
                if Process.put(:stood, v) == nil,
                  do: send(me, {:stands, self()}) && receive(do: (:go_on -> :ok))
              end,
              policy: Situ.Delivery.latest()
            )
          end)
        end,
        pipeline: settings
      )

    assert_receive {:stands, pid}
    {p, pid}
  end

  test "kills and names a stuck component while the rest keeps running" do
    {p, _pid} = standing(stop_timeout: 1_000)

    assert {:error, %{code: :component_killed, meta: %{component: "Part.Each"}}} =
             Pipeline.stop_part(p, "Part")

    assert Pipeline.state(p) == :running
    assert_receive {:main, _}
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "both callers get a reply if the pipeline is stopped in the meantime" do
    {p, pid} = standing([])
    part = Task.async(fn -> Pipeline.stop_part(p, "Part") end)
    asked(p)
    all = Task.async(fn -> Pipeline.stop(p) end)
    stopping(p)
    send(pid, :go_on)
    assert :ok = Task.await(part, 30_000)
    assert {:ok, %{errors: []}} = Task.await(all, 30_000)
  end

  defp asked(p), do: if(:sys.get_state(p).life.parts == %{}, do: asked(p), else: :ok)
  defp stopping(p), do: if(Pipeline.state(p) == :running, do: stopping(p), else: :ok)

  test "a component of the pipeline can stop another part" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          numbers = Situ.source(p, Count, count: :infinity, interval: Time.ms(1))
          side = Situ.composite(numbers, "Side", &Situ.via(&1, Tell, as: :side, to: me))
          Situ.each(side, fn v -> if v == 3, do: send(me, Pipeline.stop_part(p, "Side")) end)
        end,
        []
      )

    assert_receive :ok
    assert_receive {:side, :terminated, :normal}
    assert Pipeline.state(p) == :running
    assert {:ok, _} = Pipeline.stop(p)
  end
end
