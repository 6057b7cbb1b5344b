defmodule Situ.Store.CatalogTest do
  use ExUnit.Case, async: true
  alias Situ.Store.{Catalog, StreamInfo}

  defp parse(records),
    do: Catalog.parse(Enum.map(records, &if(is_map(&1), do: Catalog.encode(&1), else: &1)))

  defp stream(id, name, more \\ %{}),
    do: Map.merge(%{kind: "stream", id: id, name: name, type: ":integer"}, more)

  test "records say what streams there are; the last one of a thing wins" do
    catalog =
      parse([
        %{kind: "store", name: "walk", writer: "situ", volatile: true},
        stream(1, "A", %{opened: 5, large: true, compression: "zstd"}),
        stream(2, "B", %{type: "Situ.No.Such.Module"}),
        %{kind: "codec", id: 1, number: 1, name: "c", module: "Elixir.C"},
        %{kind: "fields", id: 2, module: "Elixir.M", fields: ["a"]},
        %{kind: "fields", id: 2, module: "Elixir.N", fields: ["b"]},
        %{kind: "metadata", id: 1, type: ":map", term: Base.encode64("old")},
        %{kind: "metadata", id: 1, type: ":map", term: Base.encode64("new")},
        %{kind: "closed", id: 1, time: 7},
        %{kind: "closed", id: 1, time: 9}
      ])

    assert %{name: "walk", volatile?: true, writer: "situ"} = catalog

    assert %StreamInfo{
             name: "A",
             type: :integer,
             large?: true,
             compression: :zstd,
             opened: 5,
             closed: 9,
             codecs: %{1 => {"c", "Elixir.C"}},
             supplemental: {":map", "new"}
           } = catalog.streams[1]

    # The first struct met is what the fields are of.
    assert %{type: :any, type_name: "Situ.No.Such.Module", fields: ["a"], module: "Elixir.M"} =
             catalog.streams[2]
  end

  test "what nobody understands takes nothing else with it" do
    catalog =
      parse([
        stream(1, "A"),
        "no JSON",
        <<255, 0>>,
        "[1, 2]",
        %{kind: "from the future", id: 1},
        %{kind: "metadata", id: 1, type: ":map", term: "no base 64!"},
        %{kind: "codec", id: 77, number: 1, name: "c"},
        stream(-1, "below"),
        stream(0, "the catalog itself"),
        stream(0x1_0000_0000, "beyond"),
        stream("1", "text"),
        stream(2, 5),
        stream(3, "C", %{compression: "gone"})
      ])

    assert Map.keys(catalog.streams) == [1, 3]
    assert %{compression: :none} = catalog.streams[3]
    assert catalog.streams[1].supplemental == nil
  end
end
