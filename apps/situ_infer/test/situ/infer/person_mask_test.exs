defmodule Situ.Infer.PersonMaskTest do
  use ExUnit.Case, async: true

  alias Situ.{Image, Imaging}
  alias Situ.Infer.PersonMask

  @fixtures Path.expand("../../fixtures", __DIR__)

  # The outline of the person in astronaut.png, by hand: in each row where she begins and ends. Below lies her helmet.
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

  defp picture(name), do: @fixtures |> Path.join(name) |> Imaging.read() |> elem(1)

  # How many of these columns of a row are the person's, by a mask in a box.
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

  test "the person in a photo, by her outline" do
    assert {:ok, %{rects: [rect], masks: [mask], scores: scores}} =
             PersonMask.find(picture("astronaut.png"))

    assert rect.label == "person" and rect.score > 0.9
    assert_in_delta rect.y, 15, 6
    assert overlap(mask, rect, {1, 1}) > 0.95
    assert {scores.width, scores.height, scores.format} == {256, 256, :gray8}
  end

  test "a picture of any shape is seen whole" do
    wide = "astronaut.png" |> picture() |> Imaging.resize!(1024, 400)
    assert {:ok, %{rects: [rect], masks: [mask]}} = PersonMask.find(wide)
    assert overlap(mask, rect, {2, 400 / 512}) > 0.93
  end

  test "nobody on a grey wall; pictures of one pixel and of one row are looked at, too" do
    for {w, h} <- [{640, 480}, {1, 1}, {2_000, 1}, {1, 2_000}] do
      assert {:ok, %{rects: [], masks: []}} =
               PersonMask.find(Image.filled(w, h, :bgr24, {128, 128, 128}))
    end
  end

  test "on streams: a box, its mask and the scores at the picture's time" do
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

  test "pictures of 16-bit channels and networks of another shape are refused" do
    assert {:error, %{code: :bad_image}} = PersonMask.find(Image.filled(64, 64, :gray16))

    assert {:error, %{code: :model_shape, what: what, fix: fix}} =
             PersonMask.find(Image.filled(64, 64, :gray8),
               model: Situ.Infer.Model.path("face_landmark.onnx")
             )

    assert what =~ "input" and fix =~ "model file"
  end
end
