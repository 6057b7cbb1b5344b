defmodule Situ.ImageStreamTest do
  # Every stream operator must return the same as the function of the same name, at the times of the images.
  use ExUnit.Case, async: true
  doctest Situ.ImageStream
  alias Situ.{DepthImage, Image, ImageOps, Rect, ImageStream}

  test "every operator has a doctest" do
    assert Situ.Test.Examples.list_missing(Situ.ImageStream) == []
  end

  @color Image.new_filled(12, 8, :bgr24, [10, 120, 240])
  @gray Image.new_filled(12, 8, :gray8, 90)

  for {name, input, args} <- [
        {:resize, :color, [6, 4]},
        {:resize, :color, [6, 4, [filter: :area]]},
        {:scale, :color, [0.5, 2]},
        {:letterbox, :color, [10, 10, [color: :blue]]},
        {:rotate, :color, [30]},
        {:rotate, :color, [30, [fit: :loose]]},
        {:flip, :color, [:vertical]},
        {:warp_affine, :color, [[1, 0, 2, 0, 1, 0]]},
        {:warp_perspective, :color, [[1, 0, 2, 0, 1, 0, 0, 0, 1]]},
        {:convert, :color, [:rgba64]},
        {:invert, :color, []},
        {:threshold, :gray, [50, :to_zero]},
        {:extract_channel, :color, [:red]},
        {:convolve, :gray, [[[1, 2, 1]]]},
        {:blur, :color, [1.0]},
        {:box_blur, :color, [3]},
        {:median_blur, :color, [3]},
        {:canny, :gray, [10, 20]},
        {:sobel, :gray, []},
        {:erode, :gray, [3]},
        {:dilate, :gray, [3]},
        {:open, :gray, [3]},
        {:close, :gray, [3]},
        {:equalize, :gray, []},
        {:draw, :color, [[{:line, {0, 0}, {9, 5}, []}]]},
        {:draw_line, :color, [{0, 0}, {9, 5}, [color: :white, width: 2]]},
        {:draw_rectangle, :color, [{1, 1, 5, 5}]},
        {:fill_rectangle, :color, [{1, 1, 5, 5}]},
        {:draw_circle, :color, [{6, 4}, 3]},
        {:fill_circle, :color, [{6, 4}, 3]},
        {:draw_text, :color, [{0, 0}, "x"]},
        {:crop, :color, [{1, 1, 4, 4}]},
        {:crop, :color, [{9, 6, 9, 9}, [clip: true]]},
        {:statistics, :color, []},
        {:average_color, :color, [[rect: {0, 0, 2, 2}]]},
        {:histogram, :gray, []},
        {:encode_jpeg, :color, [[quality: 70]]},
        {:encode_png, :gray, []}
      ] do
    test "#{name}(#{Enum.map_join(args, ", ", &inspect/1)})" do
      image = if unquote(input) == :gray, do: @gray, else: @color
      args = unquote(Macro.escape(args))
      {:ok, expected} = apply(ImageOps, unquote(name), [image | args])
      stream = fn p -> apply(ImageStream, unquote(name), [source(p, image) | args]) end
      assert Situ.to_list(stream, times: true) == [{10, expected}, {20, expected}]
    end
  end

  test "paste, decode, decode_depth, pseudo_colorize and transform match their functions" do
    part = Image.new_filled(2, 2, :bgr24, 1)

    assert run(@color, &ImageStream.paste(&1, part, {3, 3})) ==
             ImageOps.paste!(@color, part, {3, 3})

    png = ImageOps.encode_png!(@color)
    assert run(png, &ImageStream.decode(&1, format: :bgr24)) == @color
    depth = DepthImage.new!(width: 2, height: 1, data: <<1, 2, 3, 4>>)
    assert run(ImageOps.encode_png!(depth), &ImageStream.decode_depth/1) == depth

    assert run(depth, &ImageStream.pseudo_colorize(&1, {0.1, 2})) ==
             ImageOps.pseudo_colorize!(depth, {0.1, 2})

    assert run(@color, &ImageStream.transform(&1, fn i -> ImageOps.invert(i) end)) ==
             ImageOps.invert!(@color)

    assert run(@color, &ImageStream.transform(&1, fn i -> ImageOps.invert!(i) end)) ==
             ImageOps.invert!(@color)
  end

  test "computes differences of streams and of a stream with its past" do
    assert run(@color, &ImageStream.absdiff(&1, ImageStream.invert(&1))) ==
             ImageOps.absdiff!(@color, ImageOps.invert!(@color))

    frames = [{1, @gray}, {2, ImageOps.invert!(@gray)}, {3, @gray}]

    moved =
      Situ.to_list(fn p -> p |> Situ.from_enumerable(frames) |> ImageStream.motion() end,
        times: true
      )

    assert [{2, same}, {3, same}] = moved
    assert Image.fetch_pixel(same, 0, 0) == {:ok, [75]}
  end

  test "crops and draws on images with rectangles, and returns nil without a rectangle" do
    rect = Rect.new!(1, 1, 3, 3)
    feed = [{1, {@color, rect}}, {2, {@color, nil}}]
    out = Situ.to_list(fn p -> p |> Situ.from_enumerable(feed) |> ImageStream.crop(:paired) end)
    assert out == [ImageOps.crop!(@color, rect), nil]

    assert run({@color, [rect]}, &ImageStream.draw_detections/1) ==
             ImageOps.draw_detections!(@color, [rect])
  end

  test "crops depth images and converts them to images and back without a copy" do
    depth = DepthImage.new!(width: 4, height: 2, data: <<1::128>>, scale: 0.01, semantics: :point)
    {:ok, part} = ImageOps.crop(depth, {2, 1, 2, 1})
    assert part == %{depth | width: 2, height: 1, stride: 4, data: <<1::32>>}
    assert run(depth, &ImageStream.crop(&1, {2, 1, 2, 1})) == part
    assert run(depth, &ImageStream.crop(&1, {9, 9, 2, 1}, clip: true)) == nil

    back =
      &(&1 |> ImageStream.to_gray16() |> ImageStream.to_depth(scale: 0.01, semantics: :point))

    assert run(depth, back) == depth
    assert {:error, %{code: :bad_rect}} = ImageOps.crop(depth, {3, 1, 2, 1})
    assert_raise ArgumentError, fn -> ImageOps.crop(depth, {3, 1, 2, 1}, clipp: true) end
  end

  test "compares two streams" do
    expected = ImageOps.compare!(@gray, ImageOps.invert!(@gray), tolerance: 80)
    compare = &ImageStream.compare(&1, ImageStream.invert(&1), tolerance: 80)
    assert run(@gray, compare) == expected
    assert expected.max == 75
  end

  @tag :capture_log
  test "an invalid image stops the pipeline or is skipped" do
    feed = [{1, @color}, {2, @gray}]
    build = fn opts -> fn p -> p |> Situ.from_enumerable(feed) |> ImageStream.sobel(opts) end end
    assert {:error, error} = Situ.collect(build.([]))
    assert Exception.message(error) =~ "sobel"
    assert Situ.to_list(build.(on_error: :skip)) == [ImageOps.sobel!(@gray)]
  end

  defp source(p, data), do: Situ.from_enumerable(p, [{10, data}, {20, data}])

  defp run(data, fun) do
    [value, value] = Situ.to_list(fn p -> p |> source(data) |> fun.() end)
    value
  end
end
