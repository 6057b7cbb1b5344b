defmodule Situ.Infer.ObjectDetectorTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Infer.Detection.Yolo
  doctest Situ.Infer.Suppression

  alias Situ.{Image, Tensor}
  alias Situ.Infer.Detection.Yolo
  alias Situ.Infer.{ObjectDetector, Suppression, Test.Networks}

  defp f32(values, shape), do: Tensor.from_list(Enum.map(values, &(&1 / 1)), :f32, shape)

  # Three boxes: two of the same object, and one unlikely box of another class. {cx, cy, w, h, scores}
  @found [
    {30, 40, 20, 20, [0.9, 0.1]},
    {31, 40, 20, 20, [0.8, 0.0]},
    {70, 50, 10, 40, [0.2, 0.6]},
    {10, 50, 10, 10, [0.1, 0.2]}
  ]

  defp output(:v5),
    do: f32(for({cx, cy, w, h, s} <- @found, v <- [cx, cy, w, h, 1.0 | s], do: v), {1, 4, 7})

  defp output(:v8) do
    rows = for {cx, cy, w, h, s} <- @found, do: [cx, cy, w, h | s]
    f32(rows |> Enum.zip_with(& &1) |> Enum.concat(), {1, 6, 4})
  end

  defp output(:v10) do
    rows =
      for {cx, cy, w, h, s} <- @found, {score, class} = s |> Enum.with_index() |> Enum.max() do
        [cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2, score, class]
      end

    f32(List.flatten(rows), {1, 4, 6})
  end

  # Like `Networks.finding/2`, in half precision.
  defp half(side, {1, rows, n}) do
    %Tensor{} = found = output(:v8)

    Situ.Infer.Onnx.encode(
      inputs: [{"picture", :f16, {1, 3, side, side}}],
      outputs: [{"found", :f16, {1, rows, n}}],
      constants: %{"is" => found, "no" => f32([0], {1})},
      nodes: [
        {"Cast", ["picture"], ["floats"], [to: 1]},
        {"ReduceMean", ["floats"], ["mean"], [keepdims: 0]},
        {"Mul", ["mean", "no"], ["nothing"], []},
        {"Add", ["is", "nothing"], ["all"], []},
        {"Cast", ["all"], ["found"], [to: 10]}
      ]
    )
  end

  @tag :tmp_dir
  test "a network in half precision finds the same", %{tmp_dir: dir} do
    path = Networks.write(half(100, {1, 6, 4}), dir)
    {:ok, detect} = ObjectDetector.load(path: path, version: :v8, labels: ["cat"])
    assert {:ok, {[%{label: "cat"} = cat, %{label: "1"}], []}} = detect.(picture(200, 100))
    assert {cat.x, cat.y, cat.width, cat.height} == {40.0, 10.0, 40.0, 40.0}
    assert_in_delta cat.score, 0.9, 0.001
  end

  defp picture(w, h), do: Image.new_filled(w, h, :rgb24, 10)

  describe "finds the same objects with output format" do
    for version <- [:v5, :v8, :v10] do
      @tag :tmp_dir
      test "#{version}", %{tmp_dir: dir} do
        path = Networks.write(Networks.finding(100, %{"found" => output(unquote(version))}), dir)

        {:ok, detect} =
          ObjectDetector.load(path: path, version: unquote(version), labels: ["cat"])

        # A 200 x 100 image in a square of 100: half the size, black above and below.
        assert {:ok, {[cat, other], []}} = detect.(picture(200, 100))

        near = fn r, values ->
          for {k, v} <- values, do: assert_in_delta(Map.fetch!(r, k), v, 1.0e-4)
        end

        near.(cat, x: 40, y: 10, width: 40, height: 40, score: 0.9)
        near.(other, x: 130, y: 10, width: 20, height: 80, score: 0.6)
        assert {cat.label, other.label} == {"cat", "1"}
        # The center square: scaled by two, and cut off at its edges.
        {:ok, detect} = ObjectDetector.load(path: path, version: unquote(version), fit: :crop)
        assert {:ok, {[%{x: x, width: 40.0}, _], []}} = detect.(picture(400, 200))
        assert_in_delta x, 100 + 40, 1.0e-4
      end
    end
  end

  test "tiny YOLO v2 finds the single box of one cell and anchor" do
    # Object and class are certain in cell (3, 5) of the second anchor; the box is in the center of the cell and
    # twice the size of the anchor.
    at = fn k -> ((25 + k) * 13 + 5) * 13 + 3 end

    set = %{
      at.(0) => 0.0,
      at.(1) => 0.0,
      at.(2) => :math.log(2),
      at.(3) => :math.log(2),
      at.(4) => 10.0,
      at.(5 + 11) => 20.0
    }

    values =
      for i <- 0..(125 * 169 - 1),
          do: Map.get(set, i, if(rem(div(i, 169), 25) == 4, do: -20.0, else: 0.0))

    assert [box] = Yolo.parse_boxes(f32(values, {1, 125, 13, 13}), :v2_tiny, 0.3)
    assert box.class == 11
    assert_in_delta box.score, 0.99995, 1.0e-4
    assert_in_delta box.width, 2 * 3.42 * 32, 1.0e-3
    assert_in_delta box.x + box.width / 2, 3.5 * 32, 1.0e-3
    assert_in_delta box.y + box.height / 2, 5.5 * 32, 1.0e-3
  end

  @tag :tmp_dir
  test "masks are the part of the prototypes under the box", %{tmp_dir: dir} do
    # One box with weights for two prototypes: the first is bright in the left half, the second is dark.
    boxes = f32([50, 50, 40, 20, 0.9, 1.0, 0.0], {1, 7, 1})
    left = for _ <- 1..10, x <- 0..9, do: if(x < 5, do: 3.0, else: -3.0)
    prototypes = f32(left ++ List.duplicate(0.0, 100), {1, 2, 10, 10})
    path = Networks.write(Networks.finding(100, %{"found" => boxes, "shapes" => prototypes}), dir)

    assert [{[rect], [mask]}] =
             Situ.to_list(fn p ->
               p
               |> Situ.from_enumerable([picture(100, 100)], every: 1)
               |> Situ.map(& &1, type: Image)
               |> Situ.via(ObjectDetector, path: path, output: "found", masks: "shapes")
               |> then(&Situ.join(&1.out, &1.masks))
             end)

    assert {round(rect.x), round(rect.y)} == {30, 40}
    assert {mask.width, mask.height, mask.data} == {4, 2, <<255, 255, 0, 0, 255, 255, 0, 0>>}
  end

  @tag :tmp_dir
  test "rejects another version than the file's", %{tmp_dir: dir} do
    path = Networks.write(Networks.finding(100, %{"found" => output(:v10)}), dir)

    assert {:error, %{code: :model_shape, what: what}} =
             ObjectDetector.load(path: path, version: :v2_tiny)

    assert what =~ "{1, 4, 6}"
    assert {:error, %{code: :unknown_output}} = ObjectDetector.load(path: path, output: "boxes")
  end

  property "boxes are numbers within bounds, whatever a network returns" do
    bytes = map(list(integer(0, 255), 4 * 8 * 6), &:binary.list_to_bin/1)

    forall {data, version} <- {bytes, one_of([:v5, :v8, :v10])} do
      shape = if version == :v8, do: {1, 6, 8}, else: {1, 8, 6}
      boxes = Yolo.parse_boxes(Tensor.new(data, :f32, shape), version, 0.3)
      Enum.all?(boxes, &(&1.score >= 0.3 and &1.width > 0 and is_float(&1.x)))
    end
  end

  property "kept boxes do not overlap, and each dropped box overlaps a better kept one" do
    box =
      map(
        {integer(0, 50), integer(0, 50), integer(1, 30), integer(1, 30), integer(0, 1),
         integer(1, 1000)},
        fn {x, y, w, h, c, s} ->
          %{x: x / 1, y: y / 1, width: w / 1, height: h / 1, class: c, score: s / 1000}
        end
      )

    forall boxes <- list(box) do
      kept = Suppression.suppress_boxes(boxes, 0.4)

      clash = fn a, b ->
        a.class == b.class and Suppression.intersection_over_union(a, b) > 0.4
      end

      pairs =
        for {a, i} <- Enum.with_index(kept), {b, j} <- Enum.with_index(kept), i < j, do: {a, b}

      Enum.sort(Suppression.suppress_boxes(Enum.reverse(boxes), 0.4)) == Enum.sort(kept) and
        not Enum.any?(pairs, fn {a, b} -> clash.(a, b) end) and
        Enum.all?(boxes -- kept, fn b ->
          Enum.any?(kept, &(clash.(&1, b) and &1.score >= b.score))
        end)
    end
  end
end
