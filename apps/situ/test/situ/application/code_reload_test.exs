defmodule Situ.Application.CodeReloadTest do
  # Recompiles the module of a running pipeline several times, as a developer does.
  use ExUnit.Case, async: false

  import Situ.Test.Eventually

  alias Situ.Pipeline

  @moduletag :capture_log

  defp compile(version) do
    Code.compile_string("""
    defmodule Situ.Fixture.Lobby do
      use Situ.Pipeline

      @impl true
      def build(p, opts) do
        Situ.Pipeline.on(p, :error, fn _ -> #{version} end)
        if opts[:on_run], do: Situ.Pipeline.on(p, :run, fn _ -> opts[:on_run].() end)
        keep? = fn {v, _} -> v < 1_000 * #{version} end
        if opts[:every_build], do: opts[:every_build].()
        if opts[:held], do: Situ.source(p, Situ.Fixture.Held, to: opts[:to])

        p
        |> Situ.timer(every: Situ.Time.ms(1))
        |> Situ.scan(0, fn _, n -> n + min(#{version}, 1) end)
        |> Situ.process({#{version}, fn n -> n end}, fn m, {_, same} = state ->
          {[{m.originating_time, same.(m.data)}], state}
        end)
        |> Situ.map_async(fn n -> min(#{version}, 1) * n end)
        |> Situ.map(fn n -> {#{version}, n} end, name: "Map")
        |> Situ.map(fn seen -> seen end, policy: Situ.Delivery.max_queue(5, guarantee: keep?))
        |> Situ.each(fn seen -> send(opts[:to], {:seen, seen}) end, async: true)
        |> then(fn stream -> if(opts[:built] && #{version} == 1, do: opts[:built].(), else: stream) end)
      end
    end
    """)
  end

  setup do
    Code.compiler_options(ignore_module_conflict: true)
    on_exit(fn -> Code.compiler_options(ignore_module_conflict: false) end)
  end

  test "a running pipeline continues with the new functions and its state" do
    compile(1)
    {:ok, p} = Pipeline.start(Situ.Fixture.Lobby, to: self())
    assert_receive {:seen, {1, _}}

    last =
      for version <- 2..6, reduce: 0 do
        last ->
          compile(version)
          n = seen(version)
          assert n > last

          # Every process has released the old functions; otherwise the next version would kill it.
          assert settled()
          assert Pipeline.state(p) == :running
          n
      end

    assert last > 6
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "a pipeline takes up new functions while it is starting" do
    compile(1)
    {:ok, p} = Pipeline.start(Situ.Fixture.Lobby, to: self(), held: true)
    assert_receive {:held, held}

    for version <- 2..5 do
      compile(version)
      assert eventually(fn -> current?(:sys.get_state(p)) end)
    end

    assert Pipeline.state(p) == :starting
    send(held, :go)
    assert seen(5) > 0
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "a pipeline takes up a version that is loaded while it is being built" do
    compile(1)
    me = self()

    {:ok, p} = Pipeline.start(Situ.Fixture.Lobby, to: me, built: fn -> compile(2) end)

    assert seen(2) >= 0
    compile(3)
    assert seen(3) > 0
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "a module can be recompiled without pauses, while messages flow" do
    compile(1)
    {:ok, p} = Pipeline.start(Situ.Fixture.Lobby, to: self())
    assert_receive {:seen, {1, _}}
    for version <- 2..15, do: compile(version)
    assert seen(15) > 0
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "a module can be recompiled while a process compiles and pipelines start" do
    compile(1)
    me = self()
    compiler = Task.async(fn -> for version <- 2..15, do: compile(version) end)

    pipelines =
      for _ <- 1..10 do
        {:ok, p} = Pipeline.start(Situ.Fixture.Lobby, to: me)
        p
      end

    Task.await(compiler, 60_000)
    for _ <- pipelines, do: assert(seen(15) >= 0)
    for p <- pipelines, do: assert({:ok, %{errors: []}} = Pipeline.stop(p))
  end

  test "a module can be recompiled several times by its own build and by a :run handler" do
    for where <- [:built, :on_run] do
      compile(1)
      again = fn -> for version <- 2..5, do: compile(version) end
      {:ok, p} = Pipeline.start(Situ.Fixture.Lobby, [{:to, self()}, {where, again}])
      assert seen(5) >= 0
      assert {:ok, %{errors: []}} = Pipeline.stop(p)
      flush()
    end
  end

  test "a build that fails for a moment is repeated" do
    compile(1)
    fails = :atomics.new(1, [])
    built = fn -> :atomics.sub_get(fails, 1, 1) >= 0 && raise "not loaded yet" end
    {:ok, p} = Pipeline.start(Situ.Fixture.Lobby, to: self(), every_build: built)
    assert_receive {:seen, {1, _}}
    :atomics.put(fails, 1, 3)
    for version <- 2..4, do: compile(version)
    assert seen(4) > 0
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  defp flush do
    receive do
      {:seen, _} -> flush()
    after
      0 -> :ok
    end
  end

  # A restart must use the functions of the loaded module.
  defp current?(%{graph: graph}) do
    {:map, fun} = graph.vertices[graph.paths["Map"]].opts
    {:new_uniq, version} = Function.info(fun, :new_uniq)
    version == Situ.Fixture.Lobby.module_info(:md5)
  end

  defp seen(version) do
    receive do
      {:seen, {^version, n}} -> n
      {:seen, _} -> seen(version)
    after
      30_000 -> flunk("version #{version} was not taken up")
    end
  end

  # The compiler purges by force; a soft purge fails while any process still uses the old code.
  defp settled, do: :code.soft_purge(Situ.Fixture.Lobby) or settled()
end
