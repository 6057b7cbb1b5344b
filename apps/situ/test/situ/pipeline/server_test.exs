defmodule Situ.Pipeline.ServerTest do
  # A pipeline behaves as an OTP process: it replies to calls, and its handlers block no caller.
  use ExUnit.Case, async: true

  import Situ.Test.Eventually

  alias Situ.Fixture.Count
  alias Situ.{Clock, Pipeline, Time}

  @moduletag :capture_log

  describe "calls from anywhere" do
    test "unknown calls get an error reply and unknown casts are ignored" do
      {:ok, p} =
        Pipeline.start(fn p ->
          Situ.source(p, Count, count: :infinity, interval: Time.ms(1))
        end)

      assert eventually(fn -> Pipeline.state(p) == :running end)
      assert {:error, %{code: :unknown_request}} = GenServer.call(p, :what_is_this)
      assert {:error, %{code: :unknown_request}} = GenServer.call(p, {1, 2, 3})
      GenServer.cast(p, :nothing)
      send(p, :nothing)
      assert Pipeline.state(p) == :running
      assert {:ok, %{errors: []}} = Pipeline.stop(p)
    end

    test "a pipeline that does not run has no timing" do
      p = Pipeline.new()
      assert {:error, %{code: :not_running}} = GenServer.call(p.pid, :timing)
      assert {:ok, _} = Pipeline.stop(p)
    end

    test "a pipeline replies to supervisor calls" do
      {:ok, p} =
        Pipeline.start(fn p ->
          p |> Situ.source(Count, count: :infinity, interval: Time.ms(1)) |> Situ.map(& &1)
        end)

      assert Pipeline.clock(p)

      assert [{"Count", a, :worker, [Count]}, {"Map", b, :worker, _}] =
               Supervisor.which_children(p)

      assert Process.alive?(a) and Process.alive?(b)
      assert %{active: 2, specs: 2, workers: 2} = Supervisor.count_children(p)
      assert {:ok, _} = Pipeline.stop(p)
    end

    test "a clock that cannot be paused returns an error" do
      {:ok, p} =
        Pipeline.start(fn p -> Situ.source(p, Count, count: :infinity, interval: Time.ms(1)) end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      assert Pipeline.clock(p)
      assert {:error, %{code: :unpaced}} = Pipeline.pause(p)
      assert {:error, %{code: :unpaced}} = Pipeline.set_speed(p, 2.0)
      assert {:ok, _} = Pipeline.stop(p)
    end
  end

  describe "handlers" do
    test "may query the pipeline and take their time" do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          Pipeline.on(p, :error, fn error ->
            send(me, {:seen, error.code, Pipeline.info(p).state})
            receive do: (:go -> send(me, :gone))
          end)

          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1))
          |> Situ.each(fn v -> if v == 1, do: raise("odd") end, on_error: :skip)
        end)

      assert_receive {:seen, :component_failed, :running}
      # The pipeline does not wait for the handler.
      assert Pipeline.info(p).state == :running
      stop = Task.async(fn -> Pipeline.stop(p) end)
      assert Task.yield(stop, 50) == nil
      send(:sys.get_state(p).handlers, :go)
      assert_receive :gone
      assert {:ok, _} = Task.await(stop)
    end

    test "may extend the pipeline but not add to it directly" do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          Pipeline.on(p, :error, fn _ ->
            {:ok, _} =
              Pipeline.extend(
                p,
                &(&1 |> Pipeline.stream("Count") |> Situ.each(fn v -> send(me, {:more, v}) end))
              )
          end)

          Pipeline.on(p, :component_completed, fn _ -> Situ.return(p, 1) end)
          Situ.return(p, :x)

          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1), name: "Count")
          |> Situ.each(fn v -> if v == 1, do: raise("odd") end, on_error: :skip, async: true)

          Situ.source(p, Situ.Fixture.Silent)
        end)

      assert_receive {:more, _}
      assert {:error, %{code: :pipeline_running} = error} = Pipeline.stop(p)
      assert error.what =~ "component_completed"
    end

    test "of :run may still build" do
      me = self()

      assert {:ok, report} =
               Pipeline.run(fn p ->
                 one = Situ.return(p, 1)

                 Pipeline.on(p, :run, fn _ ->
                   p
                   |> Situ.from_enumerable([{1, :a}, {2, :b}])
                   |> Situ.each(&send(me, {:got, &1}))

                   Situ.each(one, &send(me, {:got, &1}))
                 end)
               end)

      assert length(report.closed) == 4
      for what <- [:a, :b, 1], do: assert_received({:got, ^what})
    end

    test "of :run may build in a pipeline that was opened empty" do
      me = self()
      p = Pipeline.new()
      Situ.return(p, 1)

      Pipeline.on(p, :run, fn _ ->
        p |> Situ.from_enumerable([{1, :a}]) |> Situ.each(&send(me, {:got, &1}))
      end)

      assert :ok = Pipeline.launch(p)
      assert {:ok, _} = Pipeline.await(p)
      assert_received {:got, :a}
    end
  end

  test "the clock of a paused pipeline does not advance" do
    clock = Clock.virtual(0)

    {:ok, p} =
      Pipeline.start(fn p -> Situ.timer(p, every: Time.ms(1)) end, pipeline: [clock: clock])

    assert :ok = Pipeline.pause(p)
    assert Pipeline.now(p) == Pipeline.now(p)
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "reports progress repeatedly and 1.0 exactly once at the end" do
    me = self()
    clock = Clock.manual(0)

    {:ok, p} =
      Pipeline.start(
        fn p ->
          Pipeline.on(p, :progress, &send(me, {:progress, &1}))
          Situ.timer(p, every: Time.ms(1))
        end,
        pipeline: [
          clock: clock,
          replay: [interval: {0, Time.ms(1_000)}, speed: 1.0],
          progress_every: 1
        ]
      )

    assert_receive {:progress, 0.0}
    Clock.set(clock, Time.ms(500))
    assert_receive {:progress, 0.5}
    Clock.set(clock, Time.ms(1_000))
    assert {:ok, _} = Pipeline.stop(p)
    seen = progress()
    assert seen == Enum.sort(seen)
    assert List.last(seen) == 1.0
    assert Enum.count(seen, &(&1 == 1.0)) == 1
  end

  defp progress do
    receive do
      {:progress, n} -> [n | progress()]
    after
      0 -> []
    end
  end
end
