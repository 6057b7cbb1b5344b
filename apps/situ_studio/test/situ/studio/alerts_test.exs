defmodule Situ.Studio.AlertsTest do
  # Evaluates rules against a running pipeline. Alerts are raised and cleared at the given times.
  use ExUnit.Case, async: true

  alias Situ.Studio.{Alerts, Catalog, Settings}

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    id = "alerts-#{System.unique_integer([:positive])}"
    connector = Situ.Connector.new("numbers")

    {:ok, pipeline} =
      Situ.Pipeline.start(
        fn p ->
          p |> Situ.Connector.receive(connector) |> Situ.map(& &1, name: "Level", type: :integer)
        end,
        pipeline: [name: "Mill"]
      )

    layouts = Path.join(dir, "layouts")

    {:ok, studio} =
      Situ.Studio.start_link(port: 0, id: id, pipelines: [pipeline], layouts: layouts)

    on_exit(fn ->
      Process.exit(studio, :shutdown)
      if Process.alive?(pipeline), do: Situ.Pipeline.stop(pipeline)
    end)

    # A second instance under another name, so that the test decides when it evaluates.
    {:ok, alerts} = Alerts.start_link(id: id <> "-by-hand", of: id, tick: false)
    %{id: id, by_hand: id <> "-by-hand", alerts: alerts, layouts: layouts, connector: connector}
  end

  # Delivers a number and waits until it has passed through the pipeline.
  defp level(%{id: id, connector: connector}, value) do
    now = System.os_time()
    message = %Situ.Message{data: value, originating_time: now, creation_time: now}
    {:ok, _, source} = Catalog.open_source(id, "Mill")
    _ = Situ.Studio.StreamReader.latest_at(source, "Level", now)
    Situ.Connector.deliver_messages(connector, [message])

    Stream.repeatedly(fn -> Situ.Studio.StreamReader.latest_at(source, "Level", now) end)
    |> Enum.find(&match?({:ok, %{data: ^value}}, &1))
  end

  test "raises an alert, keeps it, clears it, and removes it with its rule", context do
    %{by_hand: by_hand, alerts: alerts, layouts: layouts} = context

    :ok =
      Settings.save(layouts, %Settings{alerts: "high: Level > 10\nnever: `errors(Level)` > 0"})

    level(context, 5)
    :ok = Alerts.evaluate_rules(alerts, 100)
    assert Alerts.list_alerts(by_hand, "Mill") == []
    level(context, 50)
    :ok = Alerts.evaluate_rules(alerts, 200)

    assert [%{rule: "high", text: "Level > 10", raised: 200, cleared: nil}] =
             Alerts.list_alerts(by_hand, "Mill")

    :ok = Alerts.evaluate_rules(alerts, 300)
    assert [%{raised: 200, cleared: nil}] = Alerts.list_alerts(by_hand, "Mill")
    assert Alerts.count_active(by_hand, "Mill") == 1
    level(context, 7)
    :ok = Alerts.evaluate_rules(alerts, 400)
    assert [%{raised: 200, cleared: 400}] = Alerts.list_alerts(by_hand, "Mill")
    assert Alerts.count_active(by_hand, "Mill") == 0
    level(context, 70)
    :ok = Alerts.evaluate_rules(alerts, 500)
    assert [%{raised: 500, cleared: nil}] = Alerts.list_alerts(by_hand, "Mill")
    :ok = Settings.save(layouts, %Settings{alerts: "high: Level > 1000"})
    :ok = Alerts.evaluate_rules(alerts, 600)
    assert Alerts.list_alerts(by_hand, "Mill") == []
  end

  test "finds statistics of components and their connections by name", context do
    text = "a: `emitted(Level)` >= 0\nb: `memory(Level)` > 0\nc: `queue(Nobody)` >= 0"
    :ok = Settings.save(context.layouts, %Settings{alerts: text})
    level(context, 5)
    :ok = Alerts.evaluate_rules(context.alerts, 100)
    assert "b" in Enum.map(Alerts.list_alerts(context.by_hand, "Mill"), & &1.rule)
    refute "c" in Enum.map(Alerts.list_alerts(context.by_hand, "Mill"), & &1.rule)
  end
end
