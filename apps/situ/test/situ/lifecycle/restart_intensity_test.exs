defmodule Situ.Lifecycle.RestartIntensityTest do
  # Limits how often a component may restart, and logs the skipped errors.
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog

  alias Situ.Fixture.Count
  alias Situ.{Pipeline, Time}

  @moduletag :capture_log

  defmodule Dying do
    # Dies in handle_start/2, except the first time.
    use Situ.Component, outputs: [out: :any], options: [tries: [type: :any], to: [type: :pid]]
    @impl true
    def init(opts), do: {:ok, opts}

    @impl true
    def handle_start(_context, opts) do
      :counters.add(opts[:tries], 1, 1)

      if :counters.get(opts[:tries], 1) > 1,
        do: Process.exit(self(), :kill),
        else: send(opts[:to], {:up, self()})

      {[{:complete, :infinity}], opts}
    end
  end

  describe "restarts" do
    test "a component that keeps dying ends the pipeline" do
      me = self()
      tries = :counters.new(1, [])

      {:ok, p} =
        Pipeline.start(fn p -> Situ.source(p, Dying, tries: tries, to: me, on_error: :restart) end)

      assert_receive {:up, pid}
      Process.exit(pid, :kill)
      assert {:error, %{code: :restarted_too_often} = error} = Pipeline.await(p, 30_000)
      assert error.meta.component == "Dying"
      assert :counters.get(tries, 1) == 1 + 3
    end

    test "exceptions of components and operators count like deaths" do
      raising = fn p -> Situ.timer(p, every: Time.ms(1)) end
      boom = fn _ -> raise "boom" end

      for op <- [
            &Situ.map(&1, boom, name: "Bad", on_error: :restart),
            &Situ.process(&1, nil, fn m, _ -> boom.(m) end, name: "Bad", on_error: :restart)
          ] do
        result =
          Pipeline.run(fn p -> p |> raising.() |> op.() end, pipeline: [replay: [speed: 1.0]])

        assert {:error, %{code: :restarted_too_often} = error} = result
        assert error.meta.component == "Bad"
        assert error.meta.last.code == :component_failed
      end
    end

    test "occasional exceptions do not end the pipeline" do
      me = self()

      {:ok, p} =
        Pipeline.start(
          fn p ->
            p
            |> Situ.event_source(&send(me, {:post, &1}))
            |> Situ.each(&if(&1 == :bad, do: raise("bad"), else: send(me, {:got, &1})),
              on_error: :restart,
              async: true
            )
          end,
          pipeline: [max_restarts: 2]
        )

      assert_receive {:post, post}, 30_000
      for word <- [:bad, :bad, :good], do: post.(word)
      assert_receive {:got, :good}, 30_000
      assert Pipeline.state(p) == :running
      assert {:ok, report} = Pipeline.stop(p)
      assert report.skipped == %{"Each" => 2}
    end

    test "the settings limit the number of restarts" do
      me = self()
      tries = :counters.new(1, [])
      settings = [max_restarts: 7, max_seconds: 60]

      {:ok, p} =
        Pipeline.start(
          fn p -> Situ.source(p, Dying, tries: tries, to: me, on_error: :skip) end,
          pipeline: settings
        )

      assert_receive {:up, pid}
      Process.exit(pid, :kill)
      assert {:error, %{code: :restarted_too_often}} = Pipeline.await(p, 30_000)
      assert :counters.get(tries, 1) == 1 + 7
    end

    test "a pipeline survives a kill while it is starting" do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1), on_error: :restart)
          |> Situ.each(&send(me, {:got, &1}))

          Situ.source(p, Situ.Fixture.Held, to: me)
        end)

      # Count has started, but Held has not.
      assert_receive {:held, held}
      assert Pipeline.state(p) == :starting
      Process.exit(pid(p, "Count"), :kill)
      send(held, :go)
      assert_receive {:got, 0}, 5_000
      assert Pipeline.state(p) == :running
      assert {:ok, _} = Pipeline.stop(p)
    end

    test "every skipped error is logged exactly once" do
      log =
        capture_log(fn ->
          assert {:ok, %{skipped: %{"Map" => 5}}} =
                   Pipeline.run(
                     fn p ->
                       p
                       |> Situ.from_enumerable(Enum.map(1..10, &{&1, &1}))
                       |> Situ.map(fn v -> if rem(v, 2) == 0, do: raise("odd #{v}."), else: v end,
                         on_error: :restart
                       )
                     end,
                     pipeline: [max_restarts: 5]
                   )
        end)

      for n <- [2, 4, 6, 8, 10], do: assert(length(String.split(log, "odd #{n}.")) == 2)
    end
  end

  defp pid(p, path) do
    Enum.find_value(:sys.get_state(p).stages, fn {_, stage} ->
      Enum.any?(stage.vertices, &(&1.path == path)) && stage.pid
    end)
  end
end
