defmodule Situ.Studio.Visualizers.LinesTest do
  # Draws maps of numbers.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking

  setup do: {:ok, session: session()}

  test "draws maps of numbers as named lines with gaps", %{session: session} do
    put(session, "opening", [
      {1_100_000_000, %{"left" => 1.0}},
      {1_200_000_000, %{"left" => 2.0, "right" => 5.0}},
      {1_300_000_000, %{"right" => nil}}
    ])

    assert %{kind: 10, rows: 2, flags: 1, base: 1_100_000_000, payload: payload} =
             shown(session, "opening", "lines", 1_000_000_000, 1_500_000_000)

    nan = <<0, 0, 0, 0, 0, 0, 0xF8, 0x7F>>

    assert <<4::little-32, 3::little-32, "left", 0::32, left::binary-size(120), rest::binary>> =
             payload

    assert <<5::little-32, 2::little-32, "right", 0::24, right::binary-size(80)>> = rest

    assert <<+0.0::little-float-64, 1.0e8::little-float-64, 2.0e8::little-float-64, _::binary>> =
             left

    assert <<1.0::little-float-64, 2.0::little-float-64, ^nan::binary-8>> =
             binary_part(left, 72, 24)

    assert <<5.0::little-float-64, ^nan::binary-8>> = binary_part(right, 48, 16)
  end

  test "counts the keys that have no line", %{session: session} do
    rows = for i <- 0..1, do: {1_100_000_000 + i, Map.new(1..40, &{"key#{&1}", i})}
    put(session, "many", rows)

    assert %{rows: 32, own: 8} = shown(session, "many", "lines", 1_000_000_000, 1_500_000_000)
  end
end
