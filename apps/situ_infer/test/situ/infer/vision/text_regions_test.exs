defmodule Situ.Infer.Vision.TextRegionsTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Infer.Vision.TextRegions
  alias Situ.Tensor
  doctest Situ.Infer.Vision.TextRegions

  defp map(width, height, inside?) do
    data =
      for y <- 0..(height - 1), x <- 0..(width - 1), into: <<>> do
        p = if inside?.(x, y), do: 0.9, else: 0.05
        <<p::float-native-32>>
      end

    Tensor.new(data, :f32, {1, 1, height, width})
  end

  defp box?({x, y}, {left, top, right, low}), do: x in left..right and y in top..low

  test "areas that do not touch are separate regions, and specks are ignored" do
    places =
      TextRegions.find_regions(
        map(60, 40, fn x, y ->
          box?({x, y}, {5, 5, 40, 12}) or box?({x, y}, {10, 20, 30, 26}) or {x, y} == {50, 30}
        end)
      )

    assert [%{center: {22.5, 8.5}, right: {1.0, +0.0}} = first, %{center: {20.0, 23.0}}] =
             Enum.sort_by(places, &elem(&1.center, 1))

    # Grown on each side by 1.6 times the area divided by the circumference.
    assert_in_delta first.width, 36 + 2 * 36 * 8 * 1.6 / 88, 1.0e-6
    assert_in_delta first.height, 8 + 2 * 36 * 8 * 1.6 / 88, 1.0e-6
  end

  test "a U is one region, although its arms are joined only at the bottom" do
    u = fn x, y ->
      (x in 5..9 and y in 5..30) or (x in 30..34 and y in 5..30) or (x in 5..34 and y in 28..30)
    end

    assert [%{center: {19.5, 17.5}}] = TextRegions.find_regions(map(50, 40, u))
  end

  test "a slanted line keeps its direction, and a tall one is read downwards" do
    slanted = fn x, y -> abs(y - 50 - (x - 50) * 0.5) <= 4 and x in 15..85 end

    assert [%{right: {ux, uy}, width: w, height: h}] =
             TextRegions.find_regions(map(100, 100, slanted))

    assert_in_delta uy / ux, 0.5, 0.08
    assert w > 3 * h

    assert [%{right: {down, 1.0}}] =
             TextRegions.find_regions(map(40, 60, fn x, y -> box?({x, y}, {10, 5, 17, 50}) end))

    assert_in_delta down, 0.0, 1.0e-9
  end

  property "finds each rectangle at its position, whatever its size" do
    forall {x, y, w, h} <- {integer(0, 30), integer(0, 30), integer(5, 25), integer(5, 25)} do
      found =
        TextRegions.find_regions(
          map(64, 64, fn px, py -> box?({px, py}, {x, y, x + w, y + h}) end)
        )

      [%{center: {cx, cy}, score: score}] = found

      abs(cx - (x + w / 2)) < 1.0e-6 and abs(cy - (y + h / 2)) < 1.0e-6 and
        abs(score - 0.9) < 1.0e-3
    end
  end

  test "values that are not numbers are not text" do
    nan = <<0, 0, 0xC0, 0x7F>>
    assert TextRegions.find_regions(Tensor.new(:binary.copy(nan, 64), :f32, {1, 1, 8, 8})) == []
  end
end
