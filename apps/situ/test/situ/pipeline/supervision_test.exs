defmodule Situ.Pipeline.SupervisionTest do
  # Pipelines under the supervisors and registries of Elixir.
  use ExUnit.Case, async: true

  alias Situ.Pipeline

  @moduletag :capture_log

  defmodule Door do
    use Situ.Pipeline

    @impl true
    def build(p, opts) do
      p
      |> Situ.timer(every: Situ.Time.ms(5), name: "Timer")
      |> Situ.each(opts[:visit] || fn _ -> :ok end, name: "Visit")
    end
  end

  defmodule Once do
    use Situ.Pipeline

    @impl true
    def build(p, _opts), do: Situ.timer(p, every: Situ.Time.s(1))

    def child_spec(opts), do: %{super(opts) | restart: :temporary, shutdown: 500}
  end

  defmodule Strict do
    use Situ.Pipeline, restart: :permanent, shutdown: 3_000

    @impl true
    def build(p, _opts), do: Situ.timer(p, every: Situ.Time.s(1))
  end

  setup do
    registry = :"#{__MODULE__}.#{System.unique_integer([:positive])}"
    start_supervised!({Registry, keys: :unique, name: registry})
    %{registry: registry}
  end

  defp via(context, key), do: {:via, Registry, {context.registry, key}}

  test "a dynamic supervisor starts pipelines that are found by their key", context do
    supervisor = start_supervised!(DynamicSupervisor)

    for robot <- ["robot-1", "robot-2"] do
      spec = {Door, pipeline: [name: via(context, robot)]}
      assert {:ok, pid} = DynamicSupervisor.start_child(supervisor, spec)
      assert [{^pid, _}] = Registry.lookup(context.registry, robot)
      assert GenServer.whereis(via(context, robot)) == pid
      assert Pipeline.info(via(context, robot)).pipeline == robot
    end

    spec = {Door, pipeline: [name: via(context, "robot-1")]}

    assert {:error, %Situ.Error{code: :name_taken}} =
             DynamicSupervisor.start_child(supervisor, spec)

    assert {:ok, _} = Pipeline.stop(via(context, "robot-1"))
    assert Registry.lookup(context.registry, "robot-1") == []
    assert {:ok, _} = DynamicSupervisor.start_child(supervisor, spec)
  end

  test "a supervisor restarts a killed pipeline under its name", context do
    name = via(context, {:room, 7})
    start_supervised!({Door, pipeline: [name: name]})
    first = GenServer.whereis(name)
    monitor = Process.monitor(first)
    Process.exit(first, :kill)
    assert_receive {:DOWN, ^monitor, _, _, _}
    assert Situ.Test.Eventually.eventually(fn -> GenServer.whereis(name) not in [nil, first] end)
    assert Pipeline.info(name).pipeline == "{:room, 7}"
  end

  test "a global name is registered" do
    name = {:global, {__MODULE__, :global}}
    pid = start_supervised!({Door, pipeline: [name: name]})
    assert GenServer.whereis(name) == pid
    assert {:ok, _} = Pipeline.stop(name)
    assert GenServer.whereis(name) == nil
  end

  test "a partition supervisor starts a pipeline for each partition" do
    start_supervised!({PartitionSupervisor, child_spec: Door, name: __MODULE__.P, partitions: 3})

    for i <- 0..2 do
      assert %{state: state} = Pipeline.info({:via, PartitionSupervisor, {__MODULE__.P, i}})
      assert state in [:starting, :running]
    end
  end

  test "child specifications can be changed" do
    assert %{restart: :temporary, shutdown: 500} = Once.child_spec([])
    spec = Supervisor.child_spec({Door, []}, id: :other, restart: :permanent)
    assert %{id: :other, restart: :permanent, type: :supervisor, shutdown: 10_000} = spec
  end

  test "use Situ.Pipeline sets fields of the child specification" do
    assert %{id: Strict, restart: :permanent, shutdown: 3_000} = Strict.child_spec([])

    assert_raise Situ.Error, ~r/unknown option :restrat/, fn ->
      Code.eval_string("defmodule Typo do use Situ.Pipeline, restrat: :permanent end")
    end
  end

  test "a supervisor takes modules, functions, and several pipelines of one module" do
    clock = fn p -> Situ.timer(p, every: Situ.Time.s(1)) end
    named = for name <- ["Front", "Back"], do: {Door, pipeline: [name: name]}
    children = [Once, {Pipeline, Strict}, {Pipeline, clock} | named]
    {:ok, supervisor} = Supervisor.start_link(children, strategy: :one_for_one)
    ids = for {id, pid, _, _} <- Supervisor.which_children(supervisor), is_pid(pid), do: id
    assert Enum.sort([Once, Strict, clock, {Door, "Front"}, {Door, "Back"}]) == Enum.sort(ids)
    :ok = Supervisor.stop(supervisor)
    refute Enum.any?(Pipeline.list(), &(&1.name in ["Front", "Back"]))
  end

  test "wrong names and missing registries are errors" do
    for name <- [{:via, Registry, :key}, {:local, :name}, {:via, "x", 1}] do
      assert {:error, %Situ.Error{code: :bad_option}} =
               Pipeline.start(Door, pipeline: [name: name])
    end

    name = {:via, Registry, {__MODULE__.None, :key}}

    assert {:error, %Situ.Error{code: :name_taken, why: why}} =
             Pipeline.start(Door, pipeline: [name: name])

    assert why =~ "unknown registry"
  end
end
