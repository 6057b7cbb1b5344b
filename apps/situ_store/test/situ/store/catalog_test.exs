defmodule Situ.Store.CatalogTest do
  use ExUnit.Case, async: true
  alias Situ.Store.{Catalog, StreamInfo}

  defp parse(records),
    do:
      Catalog.parse_records(
        Enum.map(records, &if(is_map(&1), do: Catalog.encode_record(&1), else: &1))
      )

  defp stream(id, name, more \\ %{}),
    do: Map.merge(%{kind: "stream", id: id, name: name, type: ":integer"}, more)

  test "records describe the streams, and the last record of a kind wins" do
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

    # The fields are those of the first struct.
    assert %{type: :any, type_name: "Situ.No.Such.Module", fields: ["a"], module: "Elixir.M"} =
             catalog.streams[2]
  end

  test "ignores unknown records and keeps the rest" do
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

  @odd [nil, true, -1, 0, 1.5, 1.0e300, 12_345_678_901_234_567_890_123, "text", "", "\e[2J"] ++
         [[], [1], ["a"], %{}, %{"a" => 1}, "9", 1]

  test "the catalog contains only valid values, whatever the records contain" do
    records = [
      %{"kind" => "store", "name" => "x", "writer" => "y", "volatile" => false},
      %{"kind" => "stream", "id" => 1, "name" => "B", "type" => ":integer", "opened" => 5}
      |> Map.merge(%{"large" => true, "compression" => "none"}),
      %{"kind" => "codec", "id" => 1, "number" => 1, "name" => "c", "module" => "Elixir.C"},
      %{"kind" => "fields", "id" => 1, "module" => "Elixir.M", "fields" => ["a"]},
      %{"kind" => "metadata", "id" => 1, "type" => ":map", "term" => Base.encode64("x")},
      %{"kind" => "closed", "id" => 1, "time" => 7},
      %{"kind" => "piece", "every" => 10, "full" => true}
    ]

    for record <- records, key <- Map.keys(record), odd <- @odd do
      catalog = parse([stream(1, "A"), Map.put(record, key, odd)])
      said = "#{record["kind"]}.#{key}: #{inspect(odd)}"
      assert text?(catalog.name) and text?(catalog.writer), said
      assert is_boolean(catalog.volatile?), said
      assert match?(nil, catalog.piece) or sound_piece?(catalog.piece), said
      assert %{1 => _} = catalog.streams
      for {id, info} <- catalog.streams, do: assert(sound?(id, info), said)
    end
  end

  defp text?(value), do: value == nil or is_binary(value)
  defp time?(value), do: value == nil or (is_integer(value) and abs(value) <= 0x8000000000000000)

  defp sound_piece?(%{every: every, full?: full?}),
    do: is_boolean(full?) and (every == nil or every > 0)

  defp sound?(id, info) do
    is_integer(id) and is_binary(info.name) and is_binary(info.type_name) and time?(info.opened) and
      time?(info.closed) and is_boolean(info.large?) and text?(info.module) and
      (info.fields == nil or Enum.all?(info.fields, &is_binary/1)) and
      (info.supplemental == nil or
         match?({t, b} when is_binary(t) and is_binary(b), info.supplemental)) and
      Enum.all?(info.codecs, fn {n, {name, module}} ->
        n in 1..0xFFFF and is_binary(name) and text?(module)
      end)
  end
end
