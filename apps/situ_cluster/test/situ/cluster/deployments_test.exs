defmodule Situ.Cluster.DeploymentsTest do
  use ExUnit.Case, async: true

  alias Situ.Cluster.{Deployment, Deployments, SealedLog}
  alias Situ.Cluster.Log

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    {:ok, log} = Log.connect(Path.join(dir, "log"))
    {:ok, deployment} = Deployment.new(Situ.Cluster.DeploymentsTest.Hall, name: "hall")
    %{log: log, deployment: deployment}
  end

  defmodule Hall do
    use Situ.Pipeline
    @impl true
    def build(p, _opts), do: Situ.from_enumerable(p, 1..3, every: 1)
  end

  test "a second attempt records a deployment whose first attempt was interrupted", context do
    {:ok, first} = Deployments.put(context.log, context.deployment)

    # The log was lost after the deployment was recorded and before its run was marked.
    :ok = Log.delete(SealedLog.new(context.log, first.run), {:key, "run.hall.deployed"})

    assert {:ok, second} = Deployments.put(context.log, context.deployment)
    assert Deployments.list_active(context.log) == {:ok, [second]}
    assert Deployments.find_log(context.log, "hall", second.run) == {:ok, true}
  end

  test "the same deployment keeps its run, and another with its name is rejected", context do
    {:ok, first} = Deployments.put(context.log, context.deployment)
    assert Deployments.put(context.log, context.deployment) == {:ok, first}

    {:ok, other} = Deployment.new(Hall, name: "hall", opts: [rooms: 2])
    assert {:error, %{code: :duplicate_name}} = Deployments.put(context.log, other)
    assert Deployments.list_active(context.log) == {:ok, [first]}
  end
end
