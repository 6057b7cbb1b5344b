defmodule Situ.ImageOps.TextTest do
  # Compares drawn text with HarfBuzz and FreeType (priv/golden/make_text.py) and checks properties of any text.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Image, ImageOps}

  @cjk Path.expand("../../fixtures/cjk.ttf", __DIR__)

  defp black(width, height, format \\ :gray8), do: Image.new_filled(width, height, format)

  defp ink(image) do
    {:ok, %{gray: %{mean: mean}}} = image |> ImageOps.convert!(:gray8) |> ImageOps.statistics()
    mean * image.width * image.height
  end

  test "places text like HarfBuzz and draws it like FreeType" do
    golden = :situ_media |> Application.app_dir("priv/golden/text.png") |> ImageOps.read!()
    white = [255]

    drawn =
      ImageOps.draw!(black(golden.width, golden.height), [
        {:text, {10, 8}, "Grüße, Ångström, façade, fi", size: 16, color: white},
        {:text, {10.5, 36.25}, "Ελληνικά", size: 16, color: white},
        {:text, {130, 36}, "Кириллица", size: 16, color: white},
        {:text, {270, 36}, "AVATAR, Tő", size: 16, color: white},
        {:text, {10, 64}, "שלום עולם", size: 20, color: white},
        {:text, {160, 64}, "السلام عليكم", size: 20, color: white},
        {:text, {10, 100}, "small: The quick brown fox jumps over the lazy dog",
         size: 9, color: white},
        {:text, {10, 120}, "e\u0301 a\u0308 \u0e01\u0e34", size: 24, color: white},
        {:text, {150, 116}, "日本語中文字写真映像", size: 20, color: white, font: @cjk}
      ])

    # FreeType rounds outlines to 1/64 pixel, and the two count a pixel's covered part differently.
    {:ok, result} = ImageOps.compare(drawn, golden, tolerance: 12, outliers: 0.002)
    assert result.equal?, inspect(result)
    assert result.mean < 0.3
    assert ink(golden) > 255 * 2000
  end

  test "text changes only the pixels within its bounds, in every format" do
    for format <- Image.Format.list_all() do
      image = black(200, 60, format)
      {:ok, {width, height}} = ImageOps.text_size("Žluťoučký", size: 18)
      drawn = ImageOps.draw_text!(image, {20, 20}, "Žluťoučký", size: 18, color: :white)
      assert ink(ImageOps.convert!(drawn, :bgr24)) > 255 * 100
      # The caron is above the capitals by less than half their height.
      box = {18, 10, ceil(width) + 4, ceil(height) + 12}
      blank = black(elem(box, 2), elem(box, 3), format)
      assert ImageOps.paste!(drawn, blank, {18, 10}) == image
    end
  end

  test "a background covers the area below all of the text" do
    image = black(240, 80, :bgr24)

    drawn =
      ImageOps.draw_text!(image, {20, 30}, "Éléphant\nÂge",
        size: 14,
        color: :white,
        background: :blue
      )

    assert Image.fetch_pixel(drawn, 18, 30) == {:ok, [255, 0, 0]}
    # Every pixel except the background is lighter; the black around it is never mixed with white.
    assert {:ok, %{green: green, blue: blue}} = ImageOps.statistics(drawn, rect: {20, 28, 60, 40})

    assert {blue.min, green.max} == {255, 255}
  end

  test "draws shapes and text in the given order" do
    text = {:text, {0, 0}, "█", size: 30, color: 50}
    box = {:fill_rectangle, {0, 0, 40, 40}, color: 200}
    assert Image.fetch_pixel(ImageOps.draw!(black(40, 40), [text, box]), 10, 15) == {:ok, [200]}
    assert Image.fetch_pixel(ImageOps.draw!(black(40, 40), [box, text]), 10, 15) == {:ok, [50]}
  end

  test "draws a missing character as a box unless another font has it" do
    draw = &ImageOps.draw_text!(black(60, 60), {5, 15}, &1, Keyword.merge([size: 30], &2))
    assert draw.("日", []) == draw.("本", [])
    assert ink(draw.("日", [])) > 0
    assert draw.("日", font: @cjk) != draw.("日", [])
    assert draw.("A", font: @cjk) == draw.("A", font: [@cjk, @cjk])
    assert ink(draw.("A", font: @cjk)) > 0
  end

  @tag :tmp_dir
  test "a file that is not a font is an error that gives the reason", %{tmp_dir: dir} do
    image = black(20, 20)
    garbage = Path.join(dir, "garbage.ttf")
    File.write!(garbage, :binary.copy("font", 1000))
    cut = Path.join(dir, "cut.ttf")
    File.write!(cut, binary_part(File.read!(@cjk), 0, 300))

    for {path, what} <- [
          {garbage, "not a TrueType"},
          {cut, "cut.ttf"},
          {dir, "not a file"},
          {"/dev/zero", "not a file"},
          {Path.join(dir, "none.ttf"), "No such file"}
        ] do
      assert {:error, %{code: :bad_font} = error} =
               ImageOps.draw_text(image, {0, 0}, "a", font: path)

      assert Exception.message(error) =~ what
      assert {:error, %{code: :bad_font}} = ImageOps.text_size("a", font: [@cjk, path])
    end
  end

  test "rejects invalid text and options" do
    image = black(20, 20)
    assert {:error, %{code: :bad_option}} = ImageOps.draw_text(image, {0, 0}, <<200, 1>>)
    assert {:error, %{code: :bad_option}} = ImageOps.text_size(<<200, 1>>)
    assert {:error, %{code: :bad_option}} = ImageOps.draw_text(image, {0, 0}, "a", size: 0)
    assert {:error, %{code: :bad_option}} = ImageOps.draw_text(image, {0, 0}, "a", size: 1.0e9)
    assert {:error, %{code: :bad_option}} = ImageOps.draw_text(image, {1.0e9, 0}, "a")
    assert {:error, %{code: :too_large}} = ImageOps.text_size(String.duplicate("a", 70_000))
    assert_raise ArgumentError, fn -> ImageOps.draw_text(image, {0, 0}, :atom) end
    assert_raise ArgumentError, fn -> ImageOps.draw_text(image, {0, 0}, "a", colour: :red) end
    assert_raise ArgumentError, fn -> ImageOps.draw_text(image, {0, 0}, "a", font: []) end
    assert_raise ArgumentError, fn -> ImageOps.draw_line(image, {0, 0}, {1, 1}, colour: :red) end
    assert_raise ArgumentError, fn -> ImageOps.fill_circle(image, {0, 0}, 2, width: 2) end
  end

  property "any text, anywhere and at any size, draws the same as on a larger image",
    numtests: 150 do
    forall {chars, x, y, size} <-
             {list(one_of([integer(32, 0xD7FF), integer(0xE000, 0x10FFFF), integer(0, 255)])),
              integer(-80, 60), integer(-60, 40), integer(1, 60)} do
      text = List.to_string(chars)
      opts = [size: size, color: :white, font: @cjk]
      small = ImageOps.draw_text!(black(50, 30), {x, y}, text, opts)
      large = ImageOps.draw_text!(black(120, 100), {x + 40, y + 50}, text, opts)
      {:ok, {width, height}} = ImageOps.text_size(text, Keyword.take(opts, [:size, :font]))
      small == ImageOps.crop!(large, {40, 50, 50, 30}) and width >= 0 and height >= size
    end
  end
end
