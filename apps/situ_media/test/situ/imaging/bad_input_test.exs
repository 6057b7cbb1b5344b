defmodule Situ.ImageOps.BadInputTest do
  # Any invalid input returns an error that names it, and the VM survives.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{AudioBuffer, AudioFormat, DepthImage, Image, ImageOps, EncodedImage, AudioOps}

  @dir Application.app_dir(:situ_media, "priv/golden")

  test "every operator validates structs built by hand" do
    broken = %Image{width: 100, height: 100, format: :bgr24, stride: 300, data: "short"}

    for result <- [
          ImageOps.resize(broken, 10, 10),
          ImageOps.convert(broken, :gray8),
          ImageOps.crop(broken, {0, 0, 5, 5}),
          ImageOps.flip(broken, :both),
          ImageOps.rotate(broken, 10),
          ImageOps.blur(broken, 1),
          ImageOps.invert(broken),
          ImageOps.absdiff(Image.new_filled(1, 1, :gray8), broken),
          ImageOps.statistics(broken),
          ImageOps.encode_jpeg(broken),
          ImageOps.encode_png(broken),
          ImageOps.to_f32(broken),
          ImageOps.draw_line(broken, {0, 0}, {5, 5})
        ] do
      assert {:error, %Situ.Error{code: :bad_image}} = result
    end

    assert inspect(%{broken | data: nil}) == "#Situ.Image<invalid>"
  end

  test "the native code validates its own input" do
    broken = %Image{width: 100, height: 100, format: :bgr24, stride: 300, data: "short"}
    assert {:error, :bad_image, _} = Situ.Media.Native.run({:invert, broken})
    assert {:error, :bad_image, _} = Situ.Media.OpenCV.run({:gaussian, broken, 3, 1.0})
    huge = %{broken | width: 4_000_000_000, height: 4_000_000_000, stride: 4_000_000_000}
    assert {:error, :too_large, _} = Situ.Media.Native.run({:invert, huge})
    assert {:error, :bad_audio, _} = Situ.Media.Native.run_sound({:levels, "abc", {:s16, 1}})
    assert_raise ErlangError, fn -> Situ.Media.Native.run({:no_such, broken}) end
  end

  test "rejects results that would be too large before allocating memory" do
    small = Image.new_filled(2, 2, :bgr24)
    assert {:error, %{code: :too_large}} = ImageOps.resize(small, 100_000, 100_000)

    assert {:error, %{code: :too_large}} =
             ImageOps.warp_affine(small, [1, 0, 0, 0, 1, 0], width: 40_000)

    assert {:error, %{code: :bad_size}} = ImageOps.resize(small, 0, 5)
    assert {:error, %{code: :bad_size}} = ImageOps.resize(small, 2.5, 5)
    assert_raise ArgumentError, fn -> Image.new_filled(100_000, 100_000, :bgr24) end
  end

  test "operators name the format they need" do
    color = Image.new_filled(4, 4, :bgr24)

    for result <- [ImageOps.canny(color, 1, 2), ImageOps.sobel(color), ImageOps.equalize(color)] do
      assert {:error, %{code: :bad_format}} = result
    end

    assert {:error, %{code: :bad_format}} = ImageOps.convolve(color, [[1]])

    assert {:error, %{code: :bad_format}} =
             ImageOps.absdiff(color, Image.new_filled(4, 5, :bgr24))

    assert {:error, %{code: :bad_format}} = ImageOps.encode_jpeg(Image.new_filled(4, 4, :rgba64))
    assert {:error, %{code: :bad_format}} = DepthImage.from_gray16(color)
    assert {:error, %{code: :bad_option}} = ImageOps.blur(color, 1, size: 4)
    assert {:error, %{code: :bad_option}} = ImageOps.extract_channel(color, 3)
    assert {:error, %{code: :bad_option}} = ImageOps.warp_affine(color, [1, 2, 3])
  end

  describe "JPEG and PNG" do
    # A header that claims 65,500 x 65,500 pixels, followed by almost no data.
    test "headers do not determine allocations" do
      jpeg = File.read!(Path.join(@dir, "source.jpg"))
      # SOF0: marker, length, precision, height, width.
      [before, <<_::binary-size(4), rest::binary>>] = split_after(jpeg, <<0xFF, 0xC0, 0, 17, 8>>)
      huge = before <> <<65_500::16, 65_500::16>> <> rest
      assert {:error, %{code: code}} = ImageOps.parse(huge)
      assert code in [:too_large, :bad_jpeg]
      wide = before <> <<10_000::16, 10_000::16>> <> rest
      assert {:error, %{code: :bad_jpeg, what: what}} = ImageOps.parse(wide)
      assert what =~ "claims"

      assert {:error, %{code: :bad_png, what: what}} =
               ImageOps.parse(png_header(100_000, 100_000))

      assert what =~ "claims"
    end

    defp split_after(bytes, marker) do
      {at, length} = :binary.match(bytes, marker)
      <<before::binary-size(at + length), rest::binary>> = bytes
      [before, rest]
    end

    defp png_header(w, h) do
      ihdr = <<"IHDR", w::32, h::32, 8, 2, 0, 0, 0>>
      idat = "IDAT" <> :zlib.compress(<<0::800>>)
      chunk = fn c -> <<byte_size(c) - 4::32, c::binary, :erlang.crc32(c)::32>> end
      <<0x89, "PNG\r\n", 0x1A, "\n">> <> chunk.(ihdr) <> chunk.(idat) <> chunk.("IEND")
    end

    test "a file truncated at any position is an error" do
      for {name, code} <- [{"source.jpg", :bad_jpeg}, {"gray.png", :bad_png}] do
        whole = File.read!(Path.join(@dir, name))

        for at <- [8, 20, 100, div(byte_size(whole), 2), byte_size(whole) - 30] do
          assert {:error, %{code: ^code}} = ImageOps.parse(binary_part(whole, 0, at))
        end
      end
    end

    property "randomly changed bytes give an image or an error", numtests: 150 do
      forall {name, changes} <-
               {one_of(["source.jpg", "gray.png", "depth.png"]),
                nonempty_list({integer(0, 100_000), integer(0, 255)})} do
        bytes = @dir |> Path.join(name) |> File.read!()
        sound?(ImageOps.parse(Enum.reduce(changes, bytes, &change/2)))
      end
    end

    property "garbage after a signature is an error", numtests: 200 do
      forall {start, bytes} <-
               {one_of([<<0xFF, 0xD8, 0xFF>>, <<0x89, "PNG\r\n", 0x1A, "\n">>, ""]), binary()} do
        match?({:error, %Situ.Error{}}, ImageOps.parse(start <> bytes))
      end
    end

    defp change({at, byte}, bytes) do
      at = rem(at, byte_size(bytes))
      <<before::binary-size(at), _, rest::binary>> = bytes
      <<before::binary, byte, rest::binary>>
    end

    defp sound?({:ok, image}), do: match?({:ok, _}, Image.validate(image))
    defp sound?({:error, error}), do: is_exception(error)
  end

  property "every kernel returns a result for every size, stride and format", numtests: 200 do
    forall {w, h, pad, format, n} <-
             {integer(1, 40), integer(1, 20), integer(0, 9), one_of(Image.Format.list_all()),
              integer(0, 1000)} do
      stride = w * Image.Format.bytes_per_pixel(format) + pad
      data = :binary.copy(<<7, 200, 31, 90, 255>>, div(stride * h, 5) + 1)

      image =
        Image.new!(
          width: w,
          height: h,
          format: format,
          stride: stride,
          data: binary_part(data, 0, stride * h - pad)
        )

      tight = %{image | stride: stride - pad, data: Image.pixel_bytes(image)}
      ops = operations(n, image)

      # The bytes between rows make no difference.
      Enum.all?(ops, fn op -> packed(op.(image)) == packed(op.(tight)) end) and
        Enum.all?(ops, fn op -> op.(image) |> List.wrap() |> Enum.all?(&valid?/1) end)
    end
  end

  defp operations(n, image) do
    to = Enum.at(Image.Format.list_all(), rem(n, 8))

    [
      &ImageOps.convert!(&1, to),
      &ImageOps.resize!(&1, rem(n, 30) + 1, rem(n, 17) + 1,
        filter: Enum.at([:nearest, :bilinear, :bicubic, :area, :smooth, :lanczos], rem(n, 6))
      ),
      &ImageOps.letterbox!(&1, 13, 9),
      &ImageOps.flip!(&1, :both),
      &ImageOps.rotate!(&1, 90 * n),
      &ImageOps.rotate!(&1, n / 3),
      &ImageOps.invert!/1,
      &ImageOps.threshold!(&1, n, :truncate),
      &ImageOps.extract_channel!(&1, 0),
      &ImageOps.absdiff!(&1, image),
      &ImageOps.box_blur!(&1, 3),
      &ImageOps.draw!(&1, [{:line, {-5, 3}, {90, n}, []}, {:text, {0, 0}, "äb", size: 8}]),
      &ImageOps.paste!(&1, image, {rem(n, 50) - 25, -3}),
      fn image ->
        if image.format in [:gray16, :rgba64],
          do: image |> Image.pixel_bytes() |> byte_size(),
          else: ImageOps.encode_jpeg!(image)
      end,
      &(ImageOps.encode_png!(&1) |> ImageOps.parse!())
    ]
  end

  # Converting to the same format returns the image unchanged, including its gaps.
  defp packed(%Image{} = image),
    do: {image.width, image.height, image.format, Image.pixel_bytes(image)}

  defp packed(other), do: other

  defp valid?(%Image{} = image), do: match?({:ok, _}, Image.validate(image))
  defp valid?(%EncodedImage{data: data}), do: byte_size(data) > 20
  defp valid?(bytes), do: is_integer(bytes)

  test "rejects invalid audio" do
    assert {:error, %{code: :bad_audio}} =
             AudioBuffer.new(format: AudioFormat.pcm(8000, 2), data: <<0>>)

    odd = %AudioBuffer{format: AudioFormat.pcm(8000), data: "abc"}
    assert {:error, %{code: :bad_audio}} = AudioOps.level(odd)
    assert {:error, %{code: :bad_audio}} = AudioOps.resample(odd, 16_000)
    six = AudioBuffer.build_silence(AudioFormat.pcm(8000, 6), 1)
    assert {:error, %{code: :bad_option}} = AudioOps.reformat(six, channels: 2)
    assert {:error, %{code: :bad_option}} = AudioOps.select_channels(six, [6])
    assert {:error, %{code: :bad_option}} = AudioOps.resample(six, 0)
    # libsoxr would never return.
    long = AudioBuffer.build_silence(AudioFormat.pcm(11_025), 16_544)
    assert {:error, %{code: :bad_option}} = AudioOps.resample(long, 1, quality: :quick)

    assert {:error, %{code: :bad_audio}} =
             AudioOps.mix(six, AudioBuffer.build_silence(AudioFormat.pcm(), 1))
  end
end
