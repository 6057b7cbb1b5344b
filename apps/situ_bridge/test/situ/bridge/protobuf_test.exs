defmodule Situ.Bridge.ProtobufTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Foxglove.{Messages, StandardTypes}
  alias Situ.Bridge.Protobuf
  alias Situ.Bridge.Protobuf.{Descriptor, Reader, Writer}
  alias Situ.{AudioBuffer, AudioFormat, CameraIntrinsics, DepthImage, EncodedImage, GeoPoint}
  alias Situ.{Image, JointState, Point3, PointCloud, Pose, Transform}
  doctest Protobuf
  doctest StandardTypes

  @text """
  // All that a field may be.
  syntax = "proto3";
  package situ.test;
  import "google/protobuf/timestamp.proto";
  option java_package = "x";

  message All {
    enum Colour { NONE = 0; RED = 1; BLUE = -7; }
    message Inner { int32 n = 1; Inner deeper = 2; }
    reserved 5 to 7, 9;
    double d = 1; float f = 2;
    int32 i = 3; int64 l = 4; uint32 ui = 10; uint64 ul = 11; sint32 si = 12; sint64 sl = 13;
    fixed32 f3 = 14; fixed64 f6 = 15; sfixed32 sf3 = 16; sfixed64 sf6 = 17;
    bool b = 18; string s = 19; bytes y = 20 [deprecated = true];
    Colour colour = 21;
    Inner inner = 22;
    repeated sint64 packed = 23;
    repeated float loose = 24 [packed = false];
    repeated Inner inners = 25;
    map<string, Inner> map = 26;
    map<uint32, bool> numbers = 27;
    oneof choice { int32 first = 28; string second = 29; }
    optional int32 maybe = 30;
    google.protobuf.Timestamp at = 31;
    repeated Colour colours = 32;
    /* beyond two bytes */ string far = 100000;
  }
  """

  setup_all do
    %{schema: schema()}
  end

  defp schema do
    {:ok, schema} = Protobuf.parse_schema(@text)
    schema
  end

  defp integers(bits), do: integer(-Bitwise.bsl(1, bits - 1), Bitwise.bsl(1, bits - 1) - 1)
  defp naturals(bits), do: integer(0, Bitwise.bsl(1, bits) - 1)
  defp number, do: one_of([float(), :nan, :infinity, :neg_infinity])

  defp inner,
    do: map({integers(32), one_of([nil, integers(32)])}, fn {n, deep} -> inner(n, deep) end)

  defp inner(n, nil), do: %{"n" => n, "deeper" => nil}
  defp inner(n, deep), do: %{"n" => n, "deeper" => inner(deep, nil)}
  defp words, do: map(list(integer(1, 0xD7FF)), &List.to_string/1)

  defp message do
    fields = [
      {"d", number()},
      {"i", integers(32)},
      {"l", integers(64)},
      {"ui", naturals(32)},
      {"ul", naturals(64)},
      {"si", integers(32)},
      {"sl", integers(64)},
      {"f3", naturals(32)},
      {"f6", naturals(64)},
      {"sf3", integers(32)},
      {"sf6", integers(64)},
      {"b", boolean()},
      {"s", words()},
      {"y", binary()},
      {"colour", one_of(["NONE", "RED", "BLUE", 5])},
      {"inner", one_of([nil, inner()])},
      {"packed", list(integers(64))},
      {"loose", list(one_of([0.5, -1.25, :nan, :infinity]))},
      {"inners", list(inner())},
      {"map", map(list({words(), inner()}), &Map.new/1)},
      {"maybe", one_of([nil, 0, 7])},
      {"at", one_of([nil, integers(64)])},
      {"colours", list(one_of(["NONE", "BLUE"]))},
      {"far", words()}
    ]

    map(fields, &Map.new/1)
  end

  property "decodes messages with the parsed text and with its descriptor" do
    schema = schema()
    {:ok, described} = schema |> Descriptor.encode_set("situ.test.All") |> Protobuf.parse_schema()
    assert described.messages["situ.test.All"] == schema.messages["situ.test.All"]

    forall message <- message() do
      {:ok, bytes} = Protobuf.encode(schema, "situ.test.All", message)
      {:ok, read} = Protobuf.decode(described, "situ.test.All", bytes)
      Map.take(read, Map.keys(message)) == message
    end
  end

  property "decodes any bytes to a map or an error message" do
    schema = schema()

    forall {message, at, byte, garbage} <-
             {message(), non_neg_integer(), integer(0, 255), binary()} do
      {:ok, bytes} = Writer.encode(schema, "situ.test.All", message)
      cut = binary_part(bytes, 0, rem(at, byte_size(bytes) + 1))

      other =
        cut <> <<byte>> <> binary_part(bytes, byte_size(cut), byte_size(bytes) - byte_size(cut))

      for hostile <- [cut, other, garbage, cut <> garbage] do
        case Reader.decode(schema, "situ.test.All", hostile) do
          {:ok, %{}} -> true
          {:error, why} when is_binary(why) -> true
        end
      end
      |> Enum.all?()
    end
  end

  test "keeps the last value, merges parts of a message, and clears other oneof members",
       %{schema: schema} do
    encode = fn map -> elem(Protobuf.encode(schema, "situ.test.All", map), 1) end

    bytes =
      encode.(%{"i" => 1, "inner" => %{"n" => 3}, "first" => 1, "packed" => [1]}) <>
        encode.(%{
          "i" => 2,
          "inner" => %{"deeper" => %{"n" => 4}},
          "second" => "x",
          "packed" => [2, 3]
        })

    assert {:ok, read} = Protobuf.decode(schema, "situ.test.All", bytes)
    assert %{"i" => 2, "first" => nil, "second" => "x", "packed" => [1, 2, 3]} = read
    assert %{"inner" => %{"n" => 3, "deeper" => %{"n" => 4}}} = read
    assert %{"numbers" => %{"7" => true}} = again(schema, %{"numbers" => %{"7" => true}})
  end

  defp again(schema, map) do
    {:ok, bytes} = Protobuf.encode(schema, "situ.test.All", map)
    {:ok, read} = Protobuf.decode(schema, "situ.test.All", bytes)
    read
  end

  test "ignores unknown fields and groups", %{schema: schema} do
    # Field 200 is a varint, field 201 a group with a string in it, and field 3 is 5.
    bytes = <<0xC0, 0x0C, 9, 0xCB, 0x0C, 0x12, 1, ?a, 0xCC, 0x0C, 0x18, 5>>
    assert {:ok, %{"i" => 5}} = Protobuf.decode(schema, "situ.test.All", bytes)
  end

  test "reports values that do not fit", %{schema: schema} do
    for {map, why} <- [
          {%{"i" => 3_000_000_000}, "3000000000 does not fit its field"},
          {%{"colour" => "GREEN"}, "\"GREEN\" does not fit its field"},
          {%{"wrong" => 1}, "situ.test.All has no field \"wrong\""},
          {%{"s" => <<255>>}, "<<255>> does not fit its field"}
        ] do
      assert {:error, %{code: :not_writable, why: ^why}} =
               Protobuf.encode(schema, "situ.test.All", map)
    end

    assert {:error, %{code: :no_such_type}} = Protobuf.decode(schema, "All", "")
  end

  test "limits nesting to 100 levels, and the size of maps made of few bytes", %{
    schema: schema
  } do
    wrap = fn bytes -> <<0x12>> <> Writer.encode_varint(byte_size(bytes)) <> bytes end
    deep = Enum.reduce(1..120, "", fn _, bytes -> wrap.(bytes) end)
    assert {:error, why} = Reader.decode(schema, "situ.test.All.Inner", deep)
    assert why =~ "100 deep"

    fields = for n <- 1..1_000, do: "int32 f#{n} = #{n};"
    text = "syntax = \"proto3\"; message Wide { repeated Wide more = 2000; #{fields} }"
    {:ok, wide} = Protobuf.parse_schema(text)
    bomb = :binary.copy(<<0x82, 0x7D, 0>>, 100_000)
    assert {:error, why} = Reader.decode(wide, "Wide", bomb)
    assert why =~ "far more fields than it has bytes"
  end

  test "rejects invalid definitions" do
    for text <- [
          "message {",
          "message A { int32 x = 0; }",
          "message A { Nowhere x = 1; }",
          "enum",
          <<10, 3, 1>>,
          ""
        ] do
      result = Protobuf.parse_schema(text)
      assert match?({:error, %{code: :bad_definition}}, result) or text == ""
    end
  end

  # Encodes and decodes the value.
  defp there_and_back(value, frame \\ "") do
    type = StandardTypes.message_type(value)

    {:ok, bytes} =
      Writer.encode(
        Messages.load_schema(),
        type,
        StandardTypes.to_message(type, value, 5_000_000_007, frame)
      )

    {:ok, message} = Reader.decode(Messages.load_schema(), type, bytes)
    {message, StandardTypes.from_message(type, message)}
  end

  test "maps Situ's types to Foxglove's messages and back" do
    pose = %Pose{position: {1.0, 2.0, 3.0}, rotation: {0.5, 0.5, 0.5, -0.5}}
    png = <<0x89, "PNG\r\n", 0x1A, "\n", 1, 2>>
    {:ok, encoded} = EncodedImage.new(format: :png, data: png)
    {:ok, place} = GeoPoint.new(46.5, 14.5, height: 300.0, accuracy: {1.0, 2.0, 3.0})
    {:ok, joints} = JointState.new(["a", "b"], [0.5, 1.5], [0.0, -1.0])

    for value <- [
          Image.new!(width: 2, height: 1, format: :bgr24, data: <<1, 2, 3, 4, 5, 6>>),
          DepthImage.new!(width: 1, height: 2, data: <<1, 0, 2, 0>>),
          encoded,
          PointCloud.from_points([{1.0, 2.0, 3.0}, {-1.0, 0.5, 0.0}]),
          %{PointCloud.from_points([{1.0, 2.0, 3.0}]) | colors: <<10, 20, 30>>},
          pose,
          %Point3{x: 1.0, y: -2.0, z: 0.0},
          Transform.new("camera", "robot", pose),
          [
            Transform.new("camera", "robot", pose),
            Transform.new("robot", "world", Pose.identity())
          ],
          CameraIntrinsics.new!(
            width: 640,
            height: 480,
            focal: {500, 501},
            radial: [0.1, -0.2, 0.3]
          ),
          AudioBuffer.from_samples([1, -1], AudioFormat.pcm(16_000)),
          place,
          joints
        ] do
      {message, back} = there_and_back(value, "base")
      assert back == value
      if is_map_key(message, "timestamp"), do: assert(message["timestamp"] == 5_000_000_007)
      if is_map_key(message, "frame_id"), do: assert(message["frame_id"] == "base")
    end

    assert {%{"message" => "hello", "level" => "INFO"}, %{"message" => "hello"}} =
             there_and_back("hello")
  end
end
