defmodule Situ.Infer.BadInputTest do
  # Rectangles and faces from any source: each component names the invalid member, and continues with `on_error:
  # :skip`.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Infer.{Face, FaceBlur, FaceTracker, Tracker}
  alias Situ.{Image, Rect}

  @good %Rect{x: 1, y: 2, width: 8, height: 8}
  @values [nil, :nan, :inf, "3", 1.0e300, -1.0e300, -1, {}, 4_000_000_000_000, []]

  defp bad_rects do
    for name <- [:x, :y, :width, :height],
        value <- @values,
        not (name in [:x, :y] and value == -1),
        do: Map.put(@good, name, value)
  end

  defp face(rect), do: %Face{rect: rect, eyes: {{2.0, 3.0}, {6.0, 3.0}}}

  # The stream checks the type of the first message, so the component gets the second one.
  defp run(module, data, opts \\ []) do
    Situ.collect(fn p ->
      p |> Situ.from_enumerable(Enum.with_index(data, &{&2 + 1, &1})) |> Situ.via(module, opts)
    end)
  end

  @tag :capture_log
  test "an invalid rectangle is reported by its member" do
    for rect <- [nil, %{x: 1}, "box" | bad_rects()] do
      assert {:error, %{code: :bad_rect, why: why}} = Rect.validate(rect)
      assert is_binary(why)
      assert code(run(Tracker, [[], [rect]])) == :bad_rect
    end
  end

  @tag :capture_log
  test "invalid faces are reported in the tracker and the blur" do
    image = Image.new_filled(32, 32, :gray8, 200)

    for rect <- Enum.take_every(bad_rects(), 5) do
      assert code(run(FaceTracker, [[face(rect)]])) == :bad_rect
      assert code(run(FaceBlur, [{image, [face(rect)]}])) == :bad_rect
    end

    for eyes <- [nil, {nil, nil}, {{1, 2}, {:nan, 3}}, {{1.0e300, 2}, {1, 1}}] do
      assert code(run(FaceTracker, [[%{face(@good) | eyes: eyes}]])) == :bad_face
    end

    assert code(run(FaceTracker, [[], [:face]])) == :bad_face
  end

  @tag :capture_log
  test "with on_error: :skip, valid messages still pass" do
    good = [%{@good | label: "a"}]
    assert {:ok, out} = run(Tracker, [good, [%{@good | x: :nan}], good], on_error: :skip)
    assert length(out) == 2
  end

  property "rectangles within the bounds never fail" do
    number = one_of([integer(-1_000_000_000, 1_000_000_000), float()])
    size = one_of([integer(0, 1_000_000_000), float(0.0, 1.0e9)])

    forall boxes <- list({number, number, size, size}) do
      rects = for {x, y, w, h} <- boxes, do: %Rect{x: x, y: y, width: w, height: h}
      rects = for rect <- rects, match?({:ok, _}, Rect.validate(rect)), do: rect
      {_, tracker} = Tracker.update_tracks(Tracker.new(), 0, rects)
      {again, _} = Tracker.update_tracks(tracker, 40_000_000, rects)
      assert length(again) == length(rects)
    end
  end

  defp code({:error, %{meta: %{errors: [%{code: code} | _]}}}), do: code
  defp code({:error, %{code: code}}), do: code
  defp code(other), do: other
end
