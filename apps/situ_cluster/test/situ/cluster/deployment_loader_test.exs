defmodule Situ.Cluster.DeploymentLoaderTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog, only: [capture_log: 1]

  alias Situ.Cluster.{Deployment, DeploymentLoader, Deployments}
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  @moduletag :tmp_dir

  defmodule Hall do
    use Situ.Pipeline
    @impl true
    def build(p, _opts), do: Situ.from_enumerable(p, 1..3, every: 1)
  end

  defp put_deployment(log, name) do
    {:ok, deployment} = Deployment.new(Hall, name: name)
    {:ok, deployment} = Deployments.put(log, deployment)
    deployment
  end

  # The test replaces the agent, so it sees which deployments are installed.
  defp installed do
    receive do
      {:"$gen_cast", {:install, deployment}} -> [deployment | installed()]
    after
      0 -> []
    end
  end

  test "a rejected deployment is logged by name, and the others restart", %{tmp_dir: dir} do
    {:ok, log} = Log.connect(Path.join(dir, "log"))
    [first, _forged, last] = for name <- ["a", "b", "c"], do: put_deployment(log, name)

    # A writer without the cookie writes the mark of a run.
    assert {:ok, _seq} = Log.append(log, {:key, "run.b.deployed"}, 1, %Entry{op: "deployed"})

    text = capture_log(fn -> assert :ok = DeploymentLoader.run(log, self(), false) end)

    assert installed() == [first, last]
    assert text =~ ~s(the deployment "b" cannot be restarted)
    assert text =~ "has no seal"
  end
end
