defmodule Situ.Bridge.Ros.WireTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Ros.{Definition, Wire}
  doctest Wire

  @text """
  uint8 a
  float64 b
  string name
  int16[] some
  bool[3] flags
  uint8[] bytes
  Inner[] inner
  time at
  duration took
  #{String.duplicate("=", 80)}
  MSG: my/Inner
  int8 x
  uint64 y
  float32 z
  """

  defp definition do
    {:ok, definition} = Definition.parse("my/Thing", @text)
    definition
  end

  defp message do
    map(
      :proper_types.tuple([
        integer(0, 255),
        float(),
        ascii_text(),
        list(integer(-32_768, 32_767)),
        list(boolean(), 3),
        binary(),
        list(
          :proper_types.tuple([
            integer(-128, 127),
            integer(0, 0xFFFFFFFFFFFFFFFF),
            integer(-1_000, 1_000)
          ])
        ),
        integer(0, 4_000_000_000_000_000_000),
        integer(-1_000_000_000_000, 1_000_000_000_000)
      ]),
      fn {a, b, name, some, flags, bytes, inner, at, took} ->
        inner = for {x, y, z} <- inner, do: %{"x" => x, "y" => y, "z" => z / 2}

        %{
          "a" => a,
          "b" => b,
          "name" => name,
          "some" => some,
          "flags" => flags,
          "bytes" => bytes,
          "inner" => inner,
          "at" => at,
          "took" => took
        }
      end
    )
  end

  for encoding <- [:ros1, :cdr] do
    property "#{encoding} decodes any encoded message" do
      forall message <- message() do
        {:ok, bytes} = Wire.encode(definition(), message, unquote(encoding))
        assert Wire.decode(definition(), bytes, unquote(encoding)) == {:ok, message}
      end
    end
  end

  # The bytes are written by hand from the rules of CDR: each number is aligned to its size.
  test "follows ROS 2's CDR alignment, in both byte orders" do
    {:ok, d} = Definition.parse("t/T", "uint8 a\nfloat64 b\nstring s\nuint16 c")

    little =
      <<0, 1, 0, 0, 7, 0::56, 1.5::little-float-64, 3::little-32, "hi", 0, 0, 9::little-16>>

    big = <<0, 0, 0, 0, 7, 0::56, 1.5::big-float-64, 3::big-32, "hi", 0, 0, 9::big-16>>
    want = %{"a" => 7, "b" => 1.5, "s" => "hi", "c" => 9}
    assert Wire.decode(d, little, :cdr) == {:ok, want}
    assert Wire.decode(d, big, :cdr) == {:ok, want}
    assert Wire.encode(d, want, :cdr) == {:ok, little}
  end

  test "rejects numbers beyond the range of their field, and other values" do
    {:ok, d} = Definition.parse("t/T", "uint8 a\nfloat32 x")
    assert {:error, why} = Wire.encode(d, %{"a" => 256}, :ros1)
    assert why =~ "256"
    assert {:error, _} = Wire.encode(d, %{"a" => "text"}, :ros1)
    assert {:error, _} = Wire.encode(d, 5, :ros1)
    {:ok, bytes} = Wire.encode(d, %{"x" => :nan}, :ros1)
    assert Wire.decode(d, bytes, :ros1) == {:ok, %{"a" => 0, "x" => :nan}}
  end

  test "rejects counts beyond the bytes, and lists of empty types, immediately" do
    {:ok, d} = Definition.parse("t/T", "E[] es\n#{String.duplicate("=", 80)}\nMSG: t/E\n")
    assert {:error, _} = Wire.decode(d, <<0xFFFFFFFF::32>>, :ros1)
    {:ok, d} = Definition.parse("t/T", "float64[] es")
    assert {:error, _} = Wire.decode(d, <<0xFFFFFFFF::32, 0::64>>, :ros1)
  end

  test "decodes 20,000 mutated messages to values or errors" do
    message = %{
      "a" => 1,
      "b" => 2.5,
      "name" => "abc",
      "some" => [1, 2],
      "bytes" => "xyz",
      "inner" => [%{"x" => 1, "y" => 2, "z" => 0.5}],
      "at" => 5
    }

    definition = definition()
    :rand.seed(:exsss, {5, 5, 5})

    for encoding <- [:ros1, :cdr] do
      {:ok, bytes} = Wire.encode(definition, message, encoding)

      for _ <- 1..20_000 do
        at = :rand.uniform(byte_size(bytes)) - 1
        <<before::binary-size(at), _, rest::binary>> = bytes

        mutant =
          if :rand.uniform(3) == 1,
            do: before,
            else: before <> <<Enum.random([0, 1, 0x7F, 0x80, 0xFF])>> <> rest

        case Wire.decode(definition, mutant, encoding) do
          {:ok, %{}} -> :ok
          {:error, why} -> assert is_binary(why)
        end
      end
    end
  end
end
