defmodule Situ.JSONTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.JSON

  defp value do
    simple = one_of([constant(nil), boolean(), integer(), float(), string()])

    one_of([
      simple,
      list(simple),
      map(list({string(), list(simple)}), &Map.new/1),
      map({string(), list(simple)}, fn {key, list} -> [%{key => %{"in" => list}}] end)
    ])
  end

  defp string do
    char = one_of([integer(0, 127), integer(128, 0xD7FF), integer(0x10000, 0x10FFFF)])
    map(list(char), &List.to_string/1)
  end

  property "all strings and numbers round-trip" do
    forall value <- value() do
      Situ.JSON.decode(Situ.JSON.encode(value)) == {:ok, value} and
        Situ.JSON.decode(Situ.JSON.encode_pretty(value)) == {:ok, value}
    end
  end

  property "foreign bytes are decoded or refused without raising" do
    forall bytes <- binary() do
      case Situ.JSON.decode(bytes) do
        {:ok, _} -> true
        {:error, :bad_json} -> true
      end
    end
  end

  property "text that is not UTF-8 is encoded as valid text" do
    forall bytes <- binary() do
      {:ok, [%{"k" => text}]} = Situ.JSON.decode(Situ.JSON.encode([%{k: bytes}]))
      String.valid?(text) and (not String.valid?(bytes) or text == bytes)
    end
  end

  test "encodes nil as null and atoms as strings, and the last of equal keys wins" do
    assert Situ.JSON.encode([nil, true, :lz4]) == ~s([null,true,"lz4"])
    assert Situ.JSON.decode(~s({"a": 1, "a": null})) == {:ok, %{"a" => nil}}
  end

  test "refuses truncated input, trailing input, numbers out of range and invalid UTF-8" do
    for bad <- [~s({"a"), "1 2", "", "1e999", <<?", 255, ?">>, "nul", "[1,]", "{1: 2}"] do
      assert {bad, Situ.JSON.decode(bad)} == {bad, {:error, :bad_json}}
    end
  end

  test "decoded strings do not reference the text they came from" do
    {:ok, [text]} =
      Situ.JSON.decode(~s(["#{String.duplicate("x", 100)}"]) <> String.duplicate(" ", 10_000))

    assert :binary.referenced_byte_size(text) == 100
  end

  test "refuses numbers with more than 400 digits, but not long strings" do
    digits = &String.duplicate("7", &1)
    assert {:ok, [n]} = Situ.JSON.decode("[" <> digits.(400) <> "]")
    assert n == String.to_integer(digits.(400))

    for bad <- [digits.(401), "[1, -#{digits.(500)}]", ~s({"a\\"b": 0.#{digits.(401)}})],
        do: assert(Situ.JSON.decode(bad) == {:error, :bad_json})

    text = ~s(\\" #{digits.(1_000)})
    assert Situ.JSON.decode(~s(["#{text}"])) == {:ok, [~s(" #{digits.(1_000)})]}
  end

  test "refuses an exponent without digits, but not in strings" do
    for bad <- ["1e+", "[0E-]", "[1.0e-]", ~s({"e+":0.3e+}), ~s(["e-", 2E+ ])],
        do: assert(Situ.JSON.decode(bad) == {:error, :bad_json})

    text = ~s(["1e+", "\\"e-x", 1e+2, 2.5E-1])
    assert Situ.JSON.decode(text) == {:ok, ["1e+", "\"e-x", 100.0, 0.25]}
  end

  test "raises for terms that JSON cannot represent" do
    for bad <- [{1, 2}, self(), fn -> 1 end],
        do: assert_raise(ErlangError, fn -> Situ.JSON.encode(bad) end)
  end
end
