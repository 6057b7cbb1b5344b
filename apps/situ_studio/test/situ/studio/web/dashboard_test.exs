defmodule Situ.Studio.Web.DashboardTest do
  use ExUnit.Case, async: true

  # The studio is the app that can see the metrics of all others. Every expression of the dashboard for Grafana, and of
  # the alerts in the guide, must refer to metrics and labels that exist.
  alias Situ.Cluster.ClusterMetrics
  alias Situ.Link.LinkMetrics
  alias Situ.Store.StoreMetrics
  alias Situ.Test.MetricsText

  @dashboard Application.app_dir(:situ, "priv/grafana/situ.json")
  @guide Path.expand("../../../../../../docs/guides/operations.md", __DIR__)
  # Prometheus adds these labels to every series.
  @scrape_labels ~w(instance job)

  # Returns the labels of every series that a node can have.
  defp list_series do
    {:ok, p} =
      Situ.Pipeline.start(
        fn p ->
          p
          |> Situ.timer(every: Situ.Time.ms(1))
          |> Situ.each(& &1, async: true)
        end,
        pipeline: [name: "Dashboard"]
      )

    on_exit(fn -> Situ.Pipeline.stop(p) end)

    link = %{
      address: "situ://lab1",
      connected?: true,
      connections: 1,
      bytes: 1,
      round_trip: 1,
      streams: %{"imu" => %{received: 1, lost: 0, under_way: 0, lag: 1}}
    }

    vital = %{busy: 0.5, cores: 4, machine: 0.25, trips: %{:b@host => 1}}
    runners = [{"lab", %{part: "Mouth", phase: :running, epoch: 1}}]

    metrics =
      Situ.Metrics.collect() ++
        StoreMetrics.build_metrics(%{"hall" => 1}) ++
        LinkMetrics.build_metrics([link]) ++
        ClusterMetrics.build(vital, 1) ++ ClusterMetrics.build_leases(runners)

    for {_, {_, samples}} <- MetricsText.parse!(Situ.Metrics.to_text(metrics)),
        {name, labels, _} <- samples,
        into: %{},
        do: {name, Map.keys(labels)}
  end

  # Returns each metric of an expression with the labels in its braces.
  defp list_selectors(expression) do
    for [_, name | rest] <- Regex.scan(~r/\b(situ_\w+)(?:\{([^}]*)\})?/, expression) do
      labels = for [_, label] <- Regex.scan(~r/(\w+)\s*[=!]~?"/, Enum.at(rest, 0, "")), do: label
      {name, labels}
    end
  end

  defp list_groupings(expression) do
    for [_, labels] <- Regex.scan(~r/\bby\s*\(([^)]*)\)/, expression),
        label <- String.split(labels, ",", trim: true),
        do: String.trim(label)
  end

  defp check_expression(expression, series) do
    selectors = list_selectors(expression)
    assert selectors != [], "#{expression} uses no metric"

    for {name, labels} <- selectors do
      assert is_map_key(series, name), "#{name} does not exist"

      assert labels -- (series[name] ++ @scrape_labels) == [],
             "#{name} lacks a label: #{expression}"

      assert list_groupings(expression) -- (series[name] ++ @scrape_labels) == []
    end
  end

  test "the dashboard and the guide use metrics and labels that exist" do
    series = list_series()
    {:ok, dashboard} = Situ.JSON.decode(File.read!(@dashboard))

    for %{"targets" => targets} <- dashboard["panels"],
        %{"expr" => expression, "legendFormat" => legend} <- targets do
      check_expression(expression, series)
      [{name, _} | _] = list_selectors(expression)
      kept = if expression =~ " by (", do: list_groupings(expression), else: series[name]
      shown = for [_, label] <- Regex.scan(~r/\{\{(\w+)\}\}/, legend), do: label
      assert shown -- (kept ++ @scrape_labels) == [], "#{legend} shows a label that is missing"
    end

    for %{"query" => %{"query" => query}} <- dashboard["templating"]["list"],
        [_, name, label] = Regex.run(~r/label_values\((\w+), (\w+)\)/, query),
        do: assert(label in (Map.fetch!(series, name) ++ @scrape_labels))

    alerts =
      for [_, expression] <- Regex.scan(~r/^ +expr: (.+)$/m, File.read!(@guide)), do: expression

    assert length(alerts) > 3
    for expression <- alerts, do: check_expression(expression, series)
  end

  test "the panels have different ids and places" do
    {:ok, %{"panels" => panels}} = Situ.JSON.decode(File.read!(@dashboard))

    for key <- ["id", "gridPos"],
        values = Enum.map(panels, & &1[key]),
        do: assert(values == Enum.uniq(values))
  end
end
