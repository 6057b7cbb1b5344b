defmodule Situ.Studio.Web.ClusterViewTest do
  use ExUnit.Case, async: false
  alias Situ.Live.Test, as: Page
  import Situ.Studio.Asking, only: [ask: 2]
  import Situ.Test.Eventually
  alias Situ.Studio.{DataSession, StreamReader, Recordings}
  alias Situ.Studio.Web.ClusterView

  @moduletag :tmp_dir
  @moduletag capture_log: true

  defmodule Sums do
    use Situ.Pipeline

    @impl true
    def build(p, _opts) do
      p
      |> Situ.sequence(1, & &1, count: 1_000_000, every: Situ.Time.ms(1), name: "Steps")
      |> Situ.composite("Sum", &Situ.scan(&1, 0, fn a, b -> a + b end))
      |> Situ.map(& &1, name: "Result")
    end
  end

  defp open,
    do: Page.mount(ClusterView, path: "/cluster", params: %{}, session: %{"studio" => "x"})

  test "explains how to start a cluster if there is none" do
    assert Page.render(open()) =~ "not a member of a cluster"
  end

  test "shows nodes, parts with their streams, and their destinations", %{tmp_dir: dir} do
    start_supervised!({Situ.Cluster, log: dir, labels: ["lab"], devices: ["camera0"]})
    place = [{"Sum", deterministic: true}]
    {:ok, _} = Situ.Cluster.deploy(Sums, place: place, checkpoint: Situ.Time.ms(50))
    told = [to_string(node()), "lab, camera0", "Sums/Sum", "Sums/rest", "Sum.Scan"]
    page = shows(open(), told, 600)
    assert Page.has_element?(page, "#nodes") and Page.has_element?(page, "#parts")
    # The studio watches the parts like its own pipelines.
    titles = fn ->
      for {title, _} <- Recordings.Pipeline.list_running([{:all, &Situ.Cluster.pipelines/0}]),
          do: title
    end

    # A busy machine may lose a lease for a moment.
    assert eventually(fn -> "Sums/Sum" in titles.() end)
  end

  test "the streams of a part continue after it has moved", %{tmp_dir: dir} do
    start_supervised!({Situ.Cluster, log: dir})
    place = [{"Sum", deterministic: true}]
    {:ok, deployed} = Situ.Cluster.deploy(Sums, place: place, checkpoint: Situ.Time.ms(50))
    pipelines = [{:all, &Situ.Cluster.pipelines/0}]
    titles = fn -> for {title, _} <- Recordings.Pipeline.list_running(pipelines), do: title end
    assert eventually(fn -> "Sums/Sum" in titles.() end)
    supervisor = start_supervised!(DynamicSupervisor)
    {:ok, source} = Recordings.Pipeline.open(pipelines, "Sums/Sum", supervisor)
    # A page shows the stream. It requests a window once and then only new messages, and receives
    # none.
    open = %{
      "open" => [[1, %{"stream" => "Sum.Scan", "viz" => "line"}]],
      "series" => [[1, "0", "1", 1]]
    }

    {_, session} = ask(DataSession.new(source), open)
    newest = fn -> elem(ask(session, %{"live" => true}), 0) end
    assert eventually(fn -> newest.().to > newest.().from end)

    # The node releases the part and takes it again, so another pipeline runs it.
    before = Situ.Cluster.Overview.find_pipeline("Sums", "Sum")
    %{"Sum" => runner} = Situ.Cluster.Agent.list_runners("Sums")
    :ok = Situ.Cluster.Runner.restart_part(runner)
    assert Situ.Cluster.Overview.find_pipeline("Sums", "Sum") not in [nil, before]
    seen = newest.().to

    assert eventually(fn ->
             reply = newest.()
             assert reply.flags == 1
             reply.to > seen + Situ.Time.ms(100)
           end)

    # Nothing is known about the time in between.
    {:ok, messages, :all} =
      StreamReader.read_messages(source, "Sum.Scan", 0, 4_000_000_000_000_000_000, 1_000_000)

    assert Enum.count(messages, &is_struct(&1.data, Situ.Studio.Gap)) == 1
    Situ.Cluster.forget(deployed)
  end

  # The view has sent its requests. The replies arrive one node at a time.
  defp shows(page, told, left) do
    html = Page.render(page)

    case Enum.reject(told, &(html =~ &1)) do
      [] ->
        page

      missing when left == 0 ->
        flunk("the page does not show #{inspect(missing)}: #{html}")

      _ ->
        receive do
        after
          50 -> shows(page, told, left - 1)
        end
    end
  end
end
