defmodule Situ.Studio.PipelineView.AddressParamsTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Studio.PipelineView.AddressParams

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
    query |> URI.decode_query() |> AddressParams.parse_params(scopes)
  end

  test "reads an address back to the choice it was made from" do
    read = @shown |> AddressParams.build_address(%{}) |> read(["Front", "Back", "Other"])

    assert Enum.sort(read) ==
             Enum.sort(
               Map.to_list(Map.take(@shown, [:heat, :mark, :way, :folded, :selected, :plots]))
             )
  end

  test "distinguishes nothing folded from an unspecified fold" do
    nothing = AddressParams.build_address(%{@shown | folded: MapSet.new()}, %{})
    assert read(nothing, ["Front"])[:folded] == MapSet.new()
    refute Keyword.has_key?(AddressParams.parse_params(%{}, ["Front"]), :folded)
  end

  test "toggles one composite, in sorted order" do
    assert AddressParams.toggle_fold(@shown.folded, "Front") == "Back"
    assert AddressParams.toggle_fold(@shown.folded, "Middle") == "Back|Front|Middle"
  end

  property "takes only known values from any address" do
    forall {key, text} <- {one_of(["heat", "fold", "sel", "plots", "at"]), binary()} do
      read = AddressParams.parse_params(%{key => text}, ["Front"])
      assert MapSet.subset?(Keyword.get(read, :folded, MapSet.new()), MapSet.new(["Front"]))
      assert is_list(read[:plots])
      assert AddressParams.parse_params(%{key => %{"x" => text}}, [])[:plots] == []
    end
  end
end
