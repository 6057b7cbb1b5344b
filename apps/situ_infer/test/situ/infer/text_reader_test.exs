defmodule Situ.Infer.TextReaderTest do
  use ExUnit.Case, async: true
  alias Situ.{Image, ImageOps}
  alias Situ.Infer.TextReader

  defp page(width, height, lines, opts \\ []) do
    white =
      Image.new!(
        width: width,
        height: height,
        format: :rgb24,
        data: :binary.copy(<<255>>, 3 * width * height)
      )

    draw = [size: 32, color: {20, 20, 20}] ++ opts
    ImageOps.draw!(white, for({at, text} <- lines, do: {:text, at, text, draw}))
  end

  @tag :tmp_dir
  test "an invalid model folder is an error", %{tmp_dir: dir} do
    assert {:error, %{code: :no_model_file}} = TextReader.load_models(folder: dir)

    for name <- ~w(det rec),
        do: File.write!(Path.join(dir, "ch_PP-OCRv4_#{name}_infer.onnx"), "none")

    assert {:error, %{code: :bad_model}} = TextReader.load_models(folder: dir)
  end

  describe "with the model" do
    @describetag :ocr

    test "reads lines from top to bottom with their positions" do
      {:ok, reader} = TextReader.load_models()

      picture =
        page(640, 300, [
          {{40, 40}, "Platform 9"},
          {{40, 120}, "Departure 14:35"},
          {{340, 210}, "EXIT"}
        ])

      assert {:ok, lines} = TextReader.read_lines(reader, picture)
      assert ["Platform 9", "Departure 14:35", "EXIT"] = Enum.map(lines, &respaced(&1.label))
      [first, _, exit] = lines
      assert Enum.all?(lines, &(&1.score > 0.8))
      assert_in_delta first.x, 40, 12
      assert first.y > 20 and first.y < 60 and first.height > 20 and first.height < 80
      assert_in_delta exit.x, 340, 12
    end

    test "reads a rotated line in a pipeline and finds none in an image without text" do
      turned =
        640
        |> page(480, [{{160, 220}, "SLIPPERY WHEN WET"}])
        |> ImageOps.rotate!(12, color: {255, 255, 255})

      empty = page(320, 240, [])

      assert [[line], []] =
               Situ.to_list(fn p ->
                 p |> Situ.from_enumerable([turned, empty], every: 1) |> Situ.via(TextReader)
               end)

      assert String.replace(line.label, " ", "") == "SLIPPERYWHENWET"
      assert line.height > 80
    end
  end

  # Narrow spaces may be lost.
  defp respaced(text) do
    Enum.find(
      ["Platform 9", "Departure 14:35"],
      text,
      &(String.replace(&1, " ", "") == String.replace(text, " ", ""))
    )
  end

  describe "with an invalid image" do
    @describetag :ocr

    test "returns an error" do
      {:ok, reader} = TextReader.load_models()
      none = %{Image.new_filled(1, 1, :gray8, 0) | width: 0, height: 0, data: ""}
      assert {:error, %{code: :bad_image, why: why}} = TextReader.read_lines(reader, none)
      assert why =~ "0x0"
      assert {:ok, []} = TextReader.read_lines(reader, Image.new_filled(1, 1, :gray8, 0))
    end
  end
end
