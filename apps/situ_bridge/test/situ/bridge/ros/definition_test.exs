defmodule Situ.Bridge.Ros.DefinitionTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Ros.{Definition, Library}
  doctest Definition

  defp md5(name) do
    {:ok, text} = Library.fetch(name)
    {:ok, definition} = Definition.parse(name, text)
    Definition.md5(definition)
  end

  # ROS 1 (noetic) computed these sums.
  test "computes the MD5 sums of ROS's own types" do
    for {name, sum} <- [
          {"std_msgs/Header", "2176decaecbce78abc3b96ef049fabed"},
          {"std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1"},
          {"sensor_msgs/Image", "060021388200f6f0f447d0fcd9c64743"},
          {"sensor_msgs/PointCloud2", "1158d486dd51d683ce2f1be655c3c181"},
          {"sensor_msgs/NavSatFix", "2d3a8cd499b9b4a0249fb98fd05cfa48"},
          {"nav_msgs/Odometry", "cd5e73d190d741a2f92e81eda573aca7"},
          {"visualization_msgs/Marker", "4048c9de2a16f4ae8e0538085ebf1b97"}
        ],
        do: assert(md5(name) == sum, name)
  end

  test "has a complete definition of every type in the library" do
    for name <- Library.type_names(), do: assert(byte_size(md5(name)) == 32)
  end

  test "parses constants, comments, defaults, bounds and names of ROS 2" do
    text = """
    # a comment
    string NAME=a # no comment
    int32 X=-5   # a comment
    int32 x 7
    string<=10 text "default"
    float64[<=3] some
    uint8[16] id
    std_msgs/msg/String other
    """

    {:ok, definition} = Definition.parse("my_msgs/msg/Thing", text)
    assert definition.name == "my_msgs/Thing"
    thing = definition.types["my_msgs/Thing"]
    assert [{"string", "NAME", "a # no comment"}, {"int32", "X", "-5"}] = thing.constants

    assert thing.fields == [
             {"x", :int32},
             {"text", :string},
             {"some", {:list, :float64}},
             {"id", {:array, :uint8, 16}},
             {"other", {:message, "std_msgs/String"}}
           ]
  end

  # String.slice/3 raises on an emoji that invalid bytes follow.
  test "rejects a line that is not valid UTF-8, and ignores such bytes in comments" do
    bytes = "♻" <> <<181, 169>>
    rule = String.duplicate("=", 80)

    for {text, name} <- [
          {"int32 x\n#{bytes} y", "a/A"},
          {"b/B b\n#{rule}\nMSG: b/B\n#{bytes} y", "b/B"},
          {"int32 x\n#{rule}\nMSG: b/#{bytes}\nint32 =", inspect("b/" <> bytes)}
        ] do
      assert {:error, why} = Definition.parse("a/A", text)
      assert String.valid?(why)
      assert why =~ name
    end

    assert {:error, why} = Definition.parse("a/A", "#{bytes} y")
    assert why =~ "the line <<" and why =~ "not valid UTF-8"
    assert {:ok, definition} = Definition.parse("a/A", "int32 x # #{bytes}")
    assert definition.types["a/A"].fields == [{"x", :int32}]
  end

  test "rejects unusable definitions, and says why" do
    assert {:error, why} = Definition.parse("a/A", "b/Nobody x")
    assert why =~ "b/Nobody"
    assert {:error, why} = Definition.parse("a/A", "A next")
    assert why =~ "contains itself"
    assert {:error, why} = Definition.parse("a/A", "int32 1x")
    assert why =~ "1x"
    assert {:error, _} = Definition.parse("a/A", "<xml>")

    assert {:error, _} =
             Definition.parse("a/A", "int32 x\n" <> String.duplicate("=", 80) <> "\nno MSG here")
  end

  test "parses 20,000 mutations to definitions or errors" do
    {:ok, text} = Library.fetch("visualization_msgs/Marker")
    :rand.seed(:exsss, {3, 2, 1})

    for _ <- 1..20_000 do
      at = :rand.uniform(byte_size(text)) - 1
      <<before::binary-size(at), _, rest::binary>> = text

      case Definition.parse(
             "visualization_msgs/Marker",
             before <> <<Enum.random(' =[]#/<\n0aZ')>> <> rest
           ) do
        {:ok, %Definition{}} -> :ok
        {:error, why} -> assert is_binary(why)
      end
    end
  end
end
