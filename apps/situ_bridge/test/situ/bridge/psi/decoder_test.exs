defmodule Situ.Bridge.Psi.DecoderTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Psi.{Catalog, Decoder, Schema, TypePlans}

  @data Path.expand("../../../data/psi", __DIR__)

  defp types(schemas), do: TypePlans.new(Enum.map(schemas, &struct!(Schema, &1)))

  defp class(id, name, members, opts \\ []) do
    %{
      id: id,
      name: name,
      type_name: name,
      serializer: opts[:serializer] || "ClassSerializer",
      version: 2,
      flags: opts[:flags] || 1,
      members: members
    }
  end

  defp decode(types, name, bytes),
    do: Decoder.decode(bytes, TypePlans.handler(types, name), types)

  @new <<0, 0, 0, 0x80>>
  @null <<0::32>>

  describe "objects" do
    setup do
      %{types: types([class(7, "Node", [{"Name", "System.String"}, {"Next", "Node"}])])}
    end

    test "decode to the same value at every reference", %{types: types} do
      pair =
        types([
          class(7, "Node", [{"Name", "System.String"}, {"Next", "Node"}]),
          class(8, "Pair", [{"A", "Node"}, {"B", "Node"}])
        ])

      # The numbers are: pair 0, node 1, string 2.
      bytes = [@new, @new, @new, <<1::little-32, "x">>, @null, <<1, 0, 0, 0x40>>]
      node = %{"Name" => "x", "Next" => nil}

      assert decode(pair, "Pair", IO.iodata_to_binary(bytes)) ==
               {:ok, %{"A" => node, "B" => node}}

      assert {:error, _} = decode(types, "Node", <<0x40000001::little-32>>)
    end

    test "are numbered if they are in a cycle", %{types: types} do
      bytes = IO.iodata_to_binary([@new, @null, @new, @null, <<0, 0, 0, 0x40>>])

      assert {:ok, %{"$id" => 0, "Name" => nil, "Next" => %{"Next" => %{"$ref" => 0}}}} =
               decode(types, "Node", bytes)
    end

    test "of an unknown type are an error" do
      assert {:error, why} = decode(types([]), "Unknown", @new)
      assert why =~ "no schema"
      assert {:error, _} = decode(types([]), "Unknown", <<5, 0, 0, 0xC0>>)
      assert decode(types([]), "Unknown", @null) == {:ok, nil}
    end

    test "stay small if few bytes reference very many of them" do
      # Each list holds two references to the previous one, forty times: expanded, these are 2^40
      # elements.
      types = types([class(1, "Pair", [{"A", "Pair"}, {"B", "Pair"}])])
      nested = Enum.reduce(1..40, @null, fn _, inner -> [@new, inner, @null] end)
      assert {:ok, _} = decode(types, "Pair", IO.iodata_to_binary(nested))

      levels = for level <- 39..0, do: <<level + 1::little-24, 0x40>>
      bomb = IO.iodata_to_binary([List.duplicate(@new, 41), @null, @null, levels])
      {:ok, value} = decode(types, "Pair", bomb)
      assert :erts_debug.size(value) < 100_000
      assert :erts_debug.flat_size(value) < 50_000_000
    end
  end

  describe "old layouts" do
    test "include a dictionary written field by field" do
      entry = "System.Collections.Generic.Dictionary`2+Entry[[System.Int32],[System.Int32]]"

      types =
        types([
          class(
            1,
            entry,
            [
              {"hashCode", "System.Int32"},
              {"next", "System.Int32"},
              {"key", "System.Int32"},
              {"value", "System.Int32"}
            ],
            serializer: "SimpleSerializer",
            flags: 2
          ),
          class(2, "System.Collections.Generic.Dictionary`2[[System.Int32],[System.Int32]]", [
            {"entries", entry <> "[]"},
            {"count", "System.Int32"}
          ])
        ])

      row = fn hash, next, key, value ->
        for n <- [hash, next, key, value], into: "", do: <<n::little-signed-32>>
      end

      bytes = [
        @new,
        @new,
        <<3::little-32>>,
        row.(5, -1, 5, 50),
        row.(-1, -1, 0, 0),
        row.(6, 0, 6, 60),
        <<3::little-32>>
      ]

      assert decode(
               types,
               "System.Collections.Generic.Dictionary`2[[System.Int32],[System.Int32]]",
               IO.iodata_to_binary(bytes)
             ) ==
               {:ok, %{5 => 50, 6 => 60}}
    end
  end

  describe "counts" do
    test "beyond the available bytes are rejected before memory is allocated" do
      types = types([class(1, "Empty", [], flags: 2, serializer: "StructSerializer")])
      huge = @new <> <<0x7FFFFFFF::little-32>>

      for name <- ["Empty[]", "System.Double[]", "System.String[]", "System.Byte[]"],
          do: assert({:error, _} = decode(types, name, huge <> "abcdef"))
    end

    test "that leave bytes over are reported" do
      assert {:error, why} =
               decode(types([]), "System.String", @new <> <<1::little-32, "a", 0::64>>)

      assert why =~ "8 bytes are left over"
    end
  end

  # Returns all genuine messages of a store, stream by stream, as `{handler, types, bytes}`.
  defp genuine(folder, name) do
    {catalog, []} = Catalog.read(Path.join(@data, folder), name)
    types = TypePlans.new(Map.values(catalog.schemas))
    store = Situ.Store.open!(Path.join(@data, folder))
    places = store.state.tracks

    for {id, entry} <- catalog.streams,
        ordinal <- 0..(Map.fetch!(places, id).count - 1)//1,
        place = Situ.Bridge.Psi.StoreScan.Track.position_at(places[id], ordinal),
        file =
          Situ.Bridge.Psi.Files.extent_path(
            Path.join(@data, folder),
            name,
            place.file,
            place.extent
          ),
        <<_::binary-24, bytes::binary>> = binary_part(File.read!(file), place.at, place.length),
        do: {TypePlans.handler(types, entry.type_name), types, bytes}
  end

  @tag timeout: 300_000
  test "decodes 20,000 mutated messages to values or errors in bounded memory, without atoms" do
    messages =
      genuine("objects", "Objects") ++
        Enum.take(genuine("diagnostics", "Diagnostics"), -3) ++
        genuine("basics/Basics.0000", "Basics") ++ genuine("media/Media.0000", "Media")

    :rand.seed(:exsss, {4, 5, 6})
    messages = List.to_tuple(messages)
    # Other tests may load modules in parallel. A name for each mutant would add many more atoms.
    atoms = :erlang.system_info(:atom_count)

    mutants = fn ->
      Process.flag(:max_heap_size, %{size: 20_000_000, kill: true, error_logger: true})

      for _ <- 1..20_000 do
        {handler, types, bytes} = elem(messages, :rand.uniform(tuple_size(messages)) - 1)

        case Decoder.decode(mutate(bytes), handler, types) do
          {:ok, _} -> :ok
          {:error, why} when is_binary(why) -> :error
        end
      end
    end

    :rand.seed(:exsss, {4, 5, 6})
    results = Task.await(Task.async(mutants), :infinity)
    assert :error in results and :ok in results
    assert :erlang.system_info(:atom_count) - atoms < 5_000
  end

  defp mutate(bytes) do
    case :rand.uniform(5) do
      1 -> binary_part(bytes, 0, :rand.uniform(byte_size(bytes) + 1) - 1)
      2 -> bytes <> :crypto.strong_rand_bytes(:rand.uniform(16))
      _ -> Enum.reduce(1..:rand.uniform(3), bytes, fn _, bytes -> flip(bytes) end)
    end
  end

  defp flip(""), do: ""

  defp flip(bytes) do
    at = :rand.uniform(byte_size(bytes)) - 1
    <<before::binary-size(at), _, rest::binary>> = bytes

    <<before::binary, Enum.random([0, 1, 0x40, 0x7F, 0x80, 0xC0, 0xFF, :rand.uniform(256) - 1]),
      rest::binary>>
  end
end
