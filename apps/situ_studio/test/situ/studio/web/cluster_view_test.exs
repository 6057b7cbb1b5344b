defmodule Situ.Studio.Web.ClusterViewTest do
  use ExUnit.Case, async: false
  alias Situ.Live.Test, as: Page
  alias Situ.Studio.Source
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

  test "without a cluster it says how to get one" do
    assert Page.render(open()) =~ "no member of a cluster"
  end

  test "nodes, parts with their streams, and whom they go to", %{tmp_dir: dir} do
    start_supervised!({Situ.Cluster, log: dir, labels: ["lab"], devices: ["camera0"]})
    place = [{"Sum", deterministic: true}]
    {:ok, _} = Situ.Cluster.deploy(Sums, place: place, checkpoint: Situ.Time.ms(50))
    told = [to_string(node()), "lab, camera0", "Sums/Sum", "Sums/rest", "Sum.Scan"]
    page = shows(open(), told, 600)
    assert Page.has?(page, "#nodes") and Page.has?(page, "#parts")
    # The studio watches the parts as if they were pipelines of its own.
    titles =
      for {title, _} <- Source.Pipeline.running([{:all, &Situ.Cluster.pipelines/0}]), do: title

    assert "Sums/Sum" in titles
  end

  # The view has asked; the answers come by themselves, one node after the other.
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
