defmodule Situ.Infer.PersonMaskTest do
  use ExUnit.Case, async: true

  alias Situ.{Image, ImageOps}
  alias Situ.Infer.PersonMask

  @fixtures Path.expand("../../fixtures", __DIR__)

  # The outline of the person in astronaut.png, drawn by hand: where she begins and ends in each row. Her helmet is
  # below.
  @outline [
    {40, 193, 283},
    {60, 160, 296},
    {80, 154, 300},
    {100, 155, 299},
    {120, 167, 288},
    {140, 182, 265},
    {160, 132, 262},
    {180, 122, 277},
    {200, 115, 288},
    {220, 98, 300},
    {240, 78, 315},
    {260, 60, 334},
    {280, 47, 346},
    {300, 38, 353},
    {320, 32, 358}
  ]

  defp picture(name), do: @fixtures |> Path.join(name) |> ImageOps.read() |> elem(1)

  # The number of columns in a row that a mask in a box assigns to the person.
  defp inside(mask, rect, y, columns) do
    row = trunc((y + 0.5 - rect.y) / rect.height * mask.height)

    Enum.count(columns, fn x ->
      column = trunc((x + 0.5 - rect.x) / rect.width * mask.width)

      row in 0..(mask.height - 1) and column in 0..(mask.width - 1) and
        :binary.at(mask.data, row * mask.width + column) == 255
    end)
  end

  defp overlap(mask, rect, {kx, ky}) do
    {both, either} =
      Enum.reduce(@outline, {0, 0}, fn {y, from, to}, {both, either} ->
        at = fn columns -> inside(mask, rect, y * ky, Enum.map(columns, &(&1 * kx))) end
        hit = at.(from..to)
        extra = at.(0..(from - 1)) + at.((to + 1)..511)
        {both + hit, either + (to - from + 1) + extra}
      end)

    both / either
  end

  test "finds the person in a photo by her outline" do
    assert {:ok, %{rects: [rect], masks: [mask], scores: scores}} =
             PersonMask.find_person(picture("astronaut.png"))

    assert rect.label == "person" and rect.score > 0.9
    assert_in_delta rect.y, 15, 6
    assert overlap(mask, rect, {1, 1}) > 0.95
    assert {scores.width, scores.height, scores.format} == {256, 256, :gray8}
  end

  test "an image of any shape is searched completely" do
    wide = "astronaut.png" |> picture() |> ImageOps.resize!(1024, 400)
    assert {:ok, %{rects: [rect], masks: [mask]}} = PersonMask.find_person(wide)
    assert overlap(mask, rect, {2, 400 / 512}) > 0.93
  end

  test "finds nobody on a gray wall, and accepts images of one pixel or one row" do
    for {w, h} <- [{640, 480}, {1, 1}, {2_000, 1}, {1, 2_000}] do
      assert {:ok, %{rects: [], masks: []}} =
               PersonMask.find_person(Image.new_filled(w, h, :bgr24, {128, 128, 128}))
    end
  end

  test "emits a box, its mask and the scores at the image's time" do
    image = picture("astronaut.png")

    for {output, check} <- [
          out: &match?([%{label: "person"}], &1),
          masks: &match?([%Image{format: :gray8}], &1),
          scores: &match?(%Image{width: 256}, &1)
        ] do
      assert [one] =
               Situ.to_list(fn p ->
                 p
                 |> Situ.from_enumerable([image], every: 1)
                 |> Situ.map(& &1, type: Image)
                 |> Situ.via(PersonMask)
                 |> Map.fetch!(output)
               end)

      assert check.(one)
    end
  end

  test "rejects images with 16-bit channels and networks of another shape" do
    assert {:error, %{code: :bad_image}} =
             PersonMask.find_person(Image.new_filled(64, 64, :gray16))

    assert {:error, %{code: :model_shape, what: what, fix: fix}} =
             PersonMask.find_person(Image.new_filled(64, 64, :gray8),
               model: Situ.Infer.Model.bundled_path("face_landmark.onnx")
             )

    assert what =~ "input" and fix =~ "model file"
  end
end
