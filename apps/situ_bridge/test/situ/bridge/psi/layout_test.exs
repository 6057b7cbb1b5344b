defmodule Situ.Bridge.Psi.LayoutTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Psi.Layout
  doctest Layout

  test "reads numbers that Elixir's floats cannot represent" do
    assert Layout.read_value(:float64, <<0, 0, 0, 0, 0, 0, 0xF8, 0x7F>>) == :nan
    assert Layout.read_value(:float64, <<0, 0, 0, 0, 0, 0, 0xF0, 0xFF>>) == :neg_infinity
    assert Layout.read_value(:float32, <<0, 0, 0x80, 0x7F>>) == :infinity
    assert Layout.read_all(:float32, <<1.5::little-float-32, 0, 0, 0xC0, 0x7F>>) == [1.5, :nan]
  end

  test "reads decimals, GUIDs and characters" do
    assert Layout.read_value(:decimal, <<0, 0, 2, 0x80, 0::32, 5::little-64>>) == "-0.05"
    assert Layout.read_value(:decimal, <<0::32, 1::little-32, 0::64>>) == "18446744073709551616"

    guid = <<0x33221100::little-32, 0x5544::little-16, 0x7766::little-16, 0x8899AABBCCDDEEFF::64>>
    assert Layout.read_value(:guid, guid) == "33221100-5544-7766-8899-aabbccddeeff"
    assert Layout.read_value(:char, <<0x20AC::little-16>>) == "€"
    assert Layout.read_value(:char, <<0xD800::little-16>>) == "\uFFFD"
  end

  test "aligns fields to multiples of their sizes" do
    layout = Layout.struct_layout([{"a", :uint8}, {"b", :int32}, {"c", :uint8}, {"d", :float64}])
    assert {:struct, 24, 8, [{"a", 0, _}, {"b", 4, _}, {"c", 8, _}, {"d", 16, _}]} = layout
    bytes = <<1, 0::24, -2::little-signed-32, 3, 0::56, 0.5::little-float-64>>
    assert Layout.read_value(layout, bytes) == %{"a" => 1, "b" => -2, "c" => 3, "d" => 0.5}
  end

  test "reads a nullable without a value as nil, whatever bytes follow" do
    layout = Layout.struct_layout([{"hasValue", :bool}, {"value", :int32}])
    assert Layout.read_value(layout, <<0, 0::24, 7::little-32>>) == nil
    assert Layout.read_value(layout, <<1, 0::24, 7::little-32>>) == 7
  end

  property "reads arrays of numbers" do
    forall xs <- list(float()) do
      assert Layout.read_all(:float64, for(x <- xs, into: "", do: <<x::little-float-64>>)) == xs
    end
  end
end
