defmodule Situ.Studio.PipelineView.ChoiceTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Studio.PipelineView.Choice

  @shown %{
    id: "a/b",
    heat: "queue",
    mark: "waits",
    way: "TB",
    folded: MapSet.new(["Front", "Back"]),
    selected: "e1",
    plots: ["queue"],
    live: false,
    at: 7
  }

  defp read(address, scopes) do
    %URI{path: "/p/a/b", query: query} = URI.parse(address)
    query |> URI.decode_query() |> Choice.read(scopes)
  end

  test "an address gives back what it was made of" do
    read = @shown |> Choice.address(%{}) |> read(["Front", "Back", "Other"])

    assert Enum.sort(read) ==
             Enum.sort(
               Map.to_list(Map.take(@shown, [:heat, :mark, :way, :folded, :selected, :plots]))
             )
  end

  test "nothing folded is not the same as nothing said of it" do
    nothing = Choice.address(%{@shown | folded: MapSet.new()}, %{})
    assert read(nothing, ["Front"])[:folded] == MapSet.new()
    refute Keyword.has_key?(Choice.read(%{}, ["Front"]), :folded)
  end

  test "folding toggles one composite, in an order of its own" do
    assert Choice.toggle(@shown.folded, "Front") == "Back"
    assert Choice.toggle(@shown.folded, "Middle") == "Back|Front|Middle"
  end

  property "whatever an address holds, only what is known is taken" do
    forall {key, text} <- {one_of(["heat", "fold", "sel", "plots", "at"]), binary()} do
      read = Choice.read(%{key => text}, ["Front"])
      assert MapSet.subset?(Keyword.get(read, :folded, MapSet.new()), MapSet.new(["Front"]))
      assert is_list(read[:plots])
      assert Choice.read(%{key => %{"x" => text}}, [])[:plots] == []
    end
  end
end
