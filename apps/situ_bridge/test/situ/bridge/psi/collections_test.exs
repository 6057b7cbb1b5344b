defmodule Situ.Bridge.Psi.CollectionsTest do
  # Types that do not occur in the genuine stores, written by \psi's serialization rules.
  use ExUnit.Case, async: true
  alias Situ.Bridge.Psi.{Decoder, Schema, Collections, TypePlans}

  @new <<0, 0, 0, 0x80>>
  @null <<0::32>>
  @class 1
  @struct 2
  @imaging "Microsoft.Psi.Imaging."

  defp schema(name, members, opts \\ []) do
    %Schema{
      id: opts[:id] || :erlang.phash2(name, 1_000_000),
      name: name,
      type_name: name,
      serializer: opts[:by] || "ClassSerializer",
      version: opts[:version] || 2,
      flags: opts[:flags] || @class,
      members: for({name, type} <- members, do: {name, "System." <> type})
    }
  end

  # Sets members with type names that do not begin with System.
  defp typed(schema, members), do: %{schema | members: members}

  defp decode(schemas, name, parts) do
    types = TypePlans.new(schemas)

    Decoder.decode_message(
      IO.iodata_to_binary(parts),
      name,
      TypePlans.handler(types, name),
      types
    )
  end

  defp i32(n), do: <<n::little-signed-32>>
  defp f64(x), do: <<x::little-float-64>>

  describe "tuples of plain values" do
    @pair "System.ValueTuple`2[[System.Int32],[System.Double]]"

    test "are ordered by size in memory, and decode in their own order" do
      pair =
        schema(@pair, [{"Item1", "Int32"}, {"Item2", "Double"}],
          by: "SimpleSerializer",
          flags: @struct
        )

      assert decode([pair], @pair, [f64(1.5), i32(7), i32(0)]) == {:ok, {7, 1.5}}

      array = @pair <> "[]"
      bytes = [@new, i32(2), f64(1.5), i32(7), i32(0), f64(-2.5), i32(8), i32(0)]
      assert decode([pair], array, bytes) == {:ok, [{7, 1.5}, {8, -2.5}]}

      assert TypePlans.situ_type(TypePlans.new([pair]), array) ==
               {:list, {:tuple, [:integer, :float]}}
    end
  end

  describe "depth images" do
    @depth @imaging <> "DepthImage"
    @encoded @imaging <> "EncodedDepthImage"

    # The schema as the runtime writes it: it declares the scale a number, but writes a nullable
    # one.
    defp depth_schema do
      typed(schema(@depth, [], by: @depth <> "+CustomSerializer", version: 5), [
        {"compression", @imaging <> "CompressionMethod"},
        {"image", "Microsoft.Psi.Common.UnmanagedBuffer"},
        {"width", "System.Int32"},
        {"height", "System.Int32"},
        {"stride", "System.Int32"},
        {"pixelFormat", @imaging <> "PixelFormat"},
        {"depthValueSemantics", "System.Nullable`1[[#{@imaging}DepthValueSemantics]]"},
        {"depthValueToMetersScaleFactor", "System.Double"}
      ])
    end

    defp plain_depth(rest),
      do: [
        @new,
        i32(2),
        @new,
        i32(8),
        <<1::little-16, 2::little-16, 3::little-16, 4::little-16>>,
        rest
      ]

    test "have the semantics and scale of the message" do
      rest = [i32(2), i32(2), i32(4), i32(2), i32(1), i32(1), [<<1, 0::56>>, f64(0.00025)]]

      assert {:ok, %Situ.DepthImage{} = depth} =
               decode([depth_schema()], @depth, plain_depth(rest))

      assert {depth.width, depth.height, depth.stride} == {2, 2, 4}
      assert {depth.semantics, depth.scale} == {:point, 0.00025}
      assert depth.data == <<1::little-16, 2::little-16, 3::little-16, 4::little-16>>
    end

    test "default to planes in millimeters" do
      rest = [i32(2), i32(2), i32(4), i32(2), i32(0), i32(0), <<0::128>>]

      assert {:ok, %{semantics: :plane, scale: 0.001}} =
               decode([depth_schema()], @depth, plain_depth(rest))
    end

    test "of the previous version have neither semantics nor scale" do
      old = %{depth_schema() | version: 4, members: Enum.take(depth_schema().members, 6)}
      rest = [i32(2), i32(2), i32(4), i32(2)]
      assert {:ok, %Situ.DepthImage{scale: 0.001}} = decode([old], @depth, plain_depth(rest))
    end

    test "contain the file's bytes if they are compressed or encoded" do
      shared = "Microsoft.Psi.Shared`1[[#{@encoded}]]"
      container = "Microsoft.Psi.SharedContainer`1[[#{@encoded}]]"

      encoded =
        typed(schema(@encoded, []), [
          {"depthValueSemantics", "System.Nullable`1[[#{@imaging}DepthValueSemantics]]"},
          {"depthValueToMetersScaleFactor", "System.Nullable`1[[System.Double]]"},
          {"stream", "System.IO.MemoryStream"},
          {"<Width>k__BackingField", "System.Int32"},
          {"Height", "System.Int32"},
          {"PixelFormat", @imaging <> "PixelFormat"}
        ])

      encoded = %{
        encoded
        | members:
            List.keyreplace(
              encoded.members,
              "<Width>k__BackingField",
              0,
              {"Width", "System.Int32"}
            )
      }

      schemas = [
        depth_schema(),
        encoded,
        typed(schema(shared, []), [{"inner", container}]),
        typed(schema(container, []), [{"resource", @encoded}]),
        schema("System.IO.MemoryStream", [{"buffer", "Byte[]"}],
          by: "MemoryStreamSerializer+Impl",
          version: 3,
          flags: 8
        )
      ]

      png = <<0x89, "PNG\r\n", 0x1A, "\n">>
      semantics = [i32(1), i32(0)]
      scale = [<<1, 0::56>>, f64(0.001)]
      inner = [@new, @new, @new, semantics, scale, @new, i32(8), png, i32(3), i32(2), i32(2)]

      assert {:ok, %Situ.EncodedImage{format: :png, data: ^png, width: 3, height: 2}} =
               decode(schemas, shared, inner)

      compressed = [@new, i32(0), inner, semantics, scale]
      assert {:ok, %Situ.EncodedImage{data: ^png}} = decode(schemas, @depth, compressed)
    end
  end

  describe "images compressed with gzip" do
    @encoded_image @imaging <> "EncodedImage"

    defp packed(rows, w, h) do
      schemas = [
        typed(schema(@encoded_image, []), [
          {"pixelFormat", @imaging <> "PixelFormat"},
          {"stream", "System.IO.MemoryStream"},
          {"Width", "System.Int32"},
          {"Height", "System.Int32"}
        ]),
        schema("System.IO.MemoryStream", [{"buffer", "Byte[]"}],
          by: "MemoryStreamSerializer+Impl",
          version: 3,
          flags: 8
        )
      ]

      bytes = :zlib.gzip(rows)

      decode(schemas, @encoded_image, [
        @new,
        i32(3),
        @new,
        i32(byte_size(bytes)),
        bytes,
        i32(w),
        i32(h)
      ])
    end

    test "decode to images" do
      rows = <<1, 2, 3, 4, 5, 6, 0, 0, 7, 8, 9, 10, 11, 12, 0, 0>>

      assert {:ok, %Situ.Image{format: :bgr24, width: 2, height: 2, stride: 8, data: ^rows}} =
               packed(rows, 2, 2)
    end

    test "stay maps if they unpack to more bytes than the image has" do
      assert {:ok, %{"Width" => 2, "stream" => _}} = packed(:binary.copy(<<0>>, 1_000_000), 2, 2)
    end
  end

  describe "collections" do
    test "include hash sets, without their free entries" do
      entry = "System.Collections.Generic.HashSet`1+Entry[[System.Int32]]"
      set = "System.Collections.Generic.HashSet`1[[System.Int32]]"

      schemas = [
        schema(entry, [{"HashCode", "Int32"}, {"Next", "Int32"}, {"Value", "Int32"}],
          by: "SimpleSerializer",
          flags: @struct
        ),
        typed(schema(set, []), [
          {"_buckets", "System.Int32[]"},
          {"_entries", entry <> "[]"},
          {"_count", "System.Int32"}
        ])
      ]

      entries =
        for {hash, next, value} <- [{-5, -1, -5}, {6, -3, 0}, {7, 0, 7}, {0, 0, 0}],
            do: [i32(hash), i32(next), i32(value)]

      assert decode(schemas, set, [@new, @null, @new, i32(4), entries, i32(3)]) == {:ok, [-5, 7]}
      assert TypePlans.situ_type(TypePlans.new(schemas), set) == {:list, :integer}
    end

    test "include queues, from their head, and stacks, from their top" do
      members = [
        {"_array", "Int32[]"},
        {"_head", "Int32"},
        {"_tail", "Int32"},
        {"_size", "Int32"}
      ]

      queue = schema("System.Collections.Generic.Queue`1[[System.Int32]]", members)
      array = [@new, i32(4), i32(3), i32(0), i32(1), i32(2)]

      assert decode([queue], queue.name, [@new, array, i32(2), i32(1), i32(3)]) ==
               {:ok, [1, 2, 3]}

      stack =
        schema("System.Collections.Generic.Stack`1[[System.Int32]]", [
          {"_array", "Int32[]"},
          {"_size", "Int32"}
        ])

      assert decode([stack], stack.name, [@new, array, i32(2)]) == {:ok, [0, 3]}
    end

    test "include linked lists, whose nodes refer to one another" do
      list = "System.Collections.Generic.LinkedList`1[[System.String]]"
      node = "System.Collections.Generic.LinkedListNode`1[[System.String]]"

      schemas = [
        typed(schema("Two", []), [{"A", list}, {"B", list}]),
        typed(schema(list, []), [{"head", node}, {"count", "System.Int32"}]),
        typed(schema(node, []), [
          {"list", list},
          {"next", node},
          {"prev", node},
          {"item", "System.String"}
        ])
      ]

      ref = fn id -> <<id, 0, 0, 0x40>> end
      text = fn text -> [@new, i32(byte_size(text)), text] end
      # The objects are numbered: the list is 1, the nodes are 2 and 3, the strings 4 and 5.
      second = [@new, ref.(1), ref.(2), ref.(2), text.("b")]
      first = [@new, ref.(1), second, ref.(3), text.("a")]
      bytes = [@new, [@new, first, i32(2)], ref.(1)]
      assert decode(schemas, "Two", bytes) == {:ok, %{"A" => ["a", "b"], "B" => ["a", "b"]}}
      assert decode(schemas, list, [@new, @null, i32(0)]) == {:ok, []}
    end

    test "include concurrent dictionaries, with the pairs of their chains" do
      base = "System.Collections.Concurrent.ConcurrentDictionary`2"
      of = "[[System.Int32],[System.Boolean]]"
      node = base <> "+Node" <> of
      tables = base <> "+Tables" <> of

      schemas = [
        typed(schema(base <> of, []), [{"_tables", tables}, {"_budget", "System.Int32"}]),
        typed(schema(tables, []), [{"_buckets", node <> "[]"}]),
        typed(schema(node, []), [
          {"_key", "System.Int32"},
          {"_value", "System.Boolean"},
          {"_next", node}
        ])
      ]

      chain = [@new, i32(1), <<1>>, @new, i32(2), <<0>>, @null]
      bytes = [@new, @new, @new, i32(3), @null, chain, @null, i32(9)]
      assert decode(schemas, base <> of, bytes) == {:ok, %{1 => true, 2 => false}}
    end

    test "include sorted dictionaries, with the pairs of their tree" do
      generic = "System.Collections.Generic."
      of = "[[System.Int32],[System.Double]]"
      pair = generic <> "KeyValuePair`2" <> of
      tree = "#{generic}TreeSet`1[[#{pair}]]"
      node = "#{generic}SortedSet`1+Node[[#{pair}]]"

      schemas = [
        typed(schema(generic <> "SortedDictionary`2" <> of, []), [{"_set", tree}]),
        typed(schema(tree, []), [{"root", node}, {"count", "System.Int32"}]),
        typed(schema(node, []), [{"Item", pair}, {"Left", node}, {"Right", node}]),
        schema(pair, [{"key", "Int32"}, {"value", "Double"}],
          by: "SimpleSerializer",
          flags: @struct
        )
      ]

      leaf = fn key -> [@new, i32(key), i32(0), f64(key / 2), @null, @null] end
      root = [@new, i32(2), i32(0), f64(1.0), leaf.(1), leaf.(3)]

      assert decode(schemas, generic <> "SortedDictionary`2" <> of, [@new, @new, root, i32(3)]) ==
               {:ok, %{1 => 0.5, 2 => 1.0, 3 => 1.5}}
    end

    test "stay maps if their members are inconsistent" do
      junk = [nil, "text", 7, -1, [], [nil, 5, %{"Next" => "x"}], %{"root" => nil}, {1}, 1.5]

      names =
        ~w(_items _size _array _head _entries _count slots m_lastIndex root _set keys values _tables list)

      shapes =
        ~w(list stack queue set tree tree_map sorted_list concurrent wrapped old_dictionary image depth_image
           encoded_image audio nullable)a

      :rand.seed(:exsss, {3, 4, 5})

      for shape <- shapes, _ <- 1..500 do
        members = for name <- Enum.take_random(names, 4), do: {name, Enum.random(junk)}
        _ = Collections.build_value(shape, members)
      end
    end

    test "include dictionaries declared by an interface, with only their own keys" do
      generic = "System.Collections.Generic."
      of = "[[System.Int32],[System.Int32]]"
      pair = generic <> "KeyValuePair`2" <> of

      schemas = [
        typed(schema("Holder", []), [{"Any", generic <> "IDictionary`2" <> of}]),
        typed(schema(generic <> "Dictionary`2" <> of, [], id: 77), [
          {"Comparer", generic <> "IEqualityComparer`1[[System.Int32]]"},
          {"KeyValuePairs", pair <> "[]"}
        ]),
        schema(pair, [{"key", "Int32"}, {"value", "Int32"}],
          by: "SimpleSerializer",
          flags: @struct
        )
      ]

      bytes = [@new, <<77, 0, 0, 0xC0>>, @null, @new, i32(1), i32(5), i32(50)]
      assert decode(schemas, "Holder", bytes) == {:ok, %{"Any" => %{5 => 50}}}
    end
  end

  describe "enums in plain structs, which have no schema" do
    test "get the width that accounts for all bytes" do
      reading =
        typed(schema("Reading", [], by: "SimpleSerializer", flags: @struct), [
          {"Level", "Level"},
          {"N", "System.Byte"}
        ])

      assert decode([reading], "Reading", <<3, 9, 0, 0>>) == {:ok, %{"Level" => 3, "N" => 9}}

      assert decode([reading], "Reading", [i32(3), <<9, 0, 0, 0>>]) ==
               {:ok, %{"Level" => 3, "N" => 9}}

      assert decode([reading], "Reading[]", [@new, i32(3), <<1, 2, 3, 4, 5, 6, 0, 0>>]) ==
               {:ok, for({a, b} <- [{1, 2}, {3, 4}, {5, 6}], do: %{"Level" => a, "N" => b})}

      long =
        typed(schema("Long", [], by: "SimpleSerializer", flags: @struct), [{"Level", "Level"}])

      assert decode([long], "Long", <<-4::little-signed-64>>) == {:ok, %{"Level" => -4}}
    end
  end

  describe "schemas of old versions" do
    # These schemas contain neither the serializer nor whether the type is a class.
    defp old(schema), do: %{schema | serializer: "", flags: 0, version: 1}

    test "recognize structs and enums by their names and members" do
      schemas = [
        old(
          typed(schema("Microsoft.Psi.Audio.AudioBuffer", []), [
            {"format", "Wave"},
            {"data", "System.Byte[]"}
          ])
        ),
        old(
          typed(schema("Wave", []), [
            {"FormatTag", "Tag"},
            {"Channels", "System.UInt16"},
            {"SamplesPerSec", "System.UInt32"},
            {"BitsPerSample", "System.UInt16"}
          ])
        ),
        old(schema("Tag", [{"value__", "UInt16"}]))
      ]

      wave = [@new, <<1::little-16, 2::little-16, 48_000::little-32, 16::little-16>>]

      assert {:ok,
              %Situ.AudioBuffer{
                format: %{rate: 48_000, channels: 2, sample: :s16},
                data: <<1, 2, 3, 4>>
              }} =
               decode(schemas, "Microsoft.Psi.Audio.AudioBuffer", [
                 wave,
                 @new,
                 i32(4),
                 <<1, 2, 3, 4>>
               ])
    end

    test "find types that only a stream declares by their number" do
      types =
        TypePlans.new([], %{5 => "System.Double[], mscorlib", 6 => "System.String, mscorlib"})

      handler = TypePlans.handler(types, "System.Object")
      bytes = IO.iodata_to_binary([<<5, 0, 0, 0xC0>>, i32(1), f64(2.5)])
      assert Decoder.decode_message(bytes, "System.Object", handler, types) == {:ok, [2.5]}

      assert Decoder.decode_message(
               <<6, 0, 0, 0xC0, 1, 0, 0, 0, "x">>,
               "System.Object",
               handler,
               types
             ) ==
               {:ok, "x"}
    end
  end

  describe "nullable values without a schema" do
    test "are one block of memory for primitives, and a flag and a value otherwise" do
      assert decode([], "System.Nullable`1[[System.Double]]", [<<1, 0::56>>, f64(2.5)]) ==
               {:ok, 2.5}

      assert decode([], "System.Nullable`1[[System.TimeSpan]]", <<1, 7::little-64>>) == {:ok, 700}
      assert decode([], "System.Nullable`1[[System.TimeSpan]]", <<0, 0::64>>) == {:ok, nil}
    end
  end
end
