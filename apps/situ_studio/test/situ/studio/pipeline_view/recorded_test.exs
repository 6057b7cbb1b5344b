defmodule Situ.Studio.PipelineView.RecordedTest do
  # A pipeline records its own diagnostics into a store, and the page shows its graph.
  use ExUnit.Case, async: true
  alias Situ.Live.Test, as: Page
  alias Situ.Studio.{Catalog, PipelineView}

  @moduletag :tmp_dir

  test "a stored Diagnostics stream is the graph's history", %{tmp_dir: dir} do
    {:ok, _} =
      Situ.Pipeline.run(
        fn p ->
          store = Situ.Store.create(p, "shift", dir)

          p
          |> Situ.Diagnostics.stream(interval: Situ.Time.ms(20))
          |> Situ.Store.write(store, "Diagnostics")

          Situ.composite(p, "Belt", fn p ->
            p
            |> Situ.from_enumerable(0..59, every: Situ.Time.ms(10), name: "Numbers")
            |> Situ.map(&(&1 * 2), name: "Double", async: true)
          end)
          |> Situ.each(fn _ -> :ok end, name: "End", policy: Situ.Delivery.latest())
        end,
        pipeline: [replay: [speed: 1.0]]
      )

    id = "studio-#{System.unique_integer([:positive])}"
    start_supervised!({Catalog, id: id, path: dir})
    [item] = Catalog.list(id)

    page =
      Page.mount(PipelineView,
        path: "/p/x",
        params: %{"id" => [item.id], "sel" => "e1"},
        session: %{"studio" => id}
      )

    Page.render(page)
    graph = page |> Page.take_pushed_events("pipeline:graph") |> List.last()
    assert "s:Belt" in Enum.map(graph["boxes"], & &1["key"])
    assert Enum.any?(graph["nodes"], &(&1["label"] == "Double"))
    assert Enum.any?(graph["edges"], &(&1["lossy"] and &1["policy"] == "latest"))
    # A busy machine records fewer moments, but the page must contain each of them.
    {:ok, reader} = Situ.Store.open(Path.join(dir, "shift.0000"))
    moments = reader |> Situ.Store.messages("Diagnostics") |> Enum.count()
    assert moments > 0
    assert String.to_integer(Page.get_attribute(page, "#moments input", "max")) == moments - 1
    rows = page |> Page.take_pushed_events("pipeline:series") |> List.last() |> Map.fetch!("rows")
    assert length(rows) == moments
    assert Page.text(page, ".status") =~ "recorded"
  end
end
