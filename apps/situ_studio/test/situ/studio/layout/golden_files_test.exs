defmodule Situ.Studio.Layout.GoldenFilesTest do
  # Parses the layouts of test/golden, which every later version must be able to read.
  use ExUnit.Case, async: true
  alias Situ.Studio.Layout.{Json, Panel, Tree, Visualization}

  @files Path.wildcard(Path.expand("../../../../../../test/golden/*/layout.json", __DIR__))

  test "there are golden layouts" do
    assert @files != []
  end

  for file <- @files do
    test "#{Path.basename(Path.dirname(file))}: the layout has its panels" do
      assert {:ok, layout} = unquote(file) |> File.read!() |> Json.parse_json()
      assert layout.name == "golden"

      assert [
               %Panel{id: "p1", panel: :plot, vis: [line]} = plot,
               %Panel{panel: :image},
               %Panel{panel: :value}
             ] = layout.panels

      assert [:column, "p1", [:row, _, _]] = Tree.to_list(layout.tree)
      assert Tree.find(layout.tree, "p1").size == 120

      assert {plot.axis, plot.threshold} == {{-1.5, 40}, {:above, 30}}
      assert %Visualization{viz: "line", stream: "Floats", props: props} = line
      assert props == %{"width" => 2, "color" => "#4cc38a"}
    end
  end
end
