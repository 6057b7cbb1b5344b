defmodule Situ.ImageOps.HostileTest do
  # Arguments and bytes that ask for too much work return an error in bounded time.
  use ExUnit.Case, async: true
  alias Situ.{Image, ImageOps}

  defp gray(w, h, fun),
    do:
      Image.new!(
        width: w,
        height: h,
        format: :gray8,
        data: for(y <- 0..(h - 1), x <- 0..(w - 1), into: <<>>, do: <<fun.(x, y)>>)
      )

  test "extremely large numbers are errors, not exceptions" do
    image = Image.new_filled(8, 8, :gray8, 7)
    huge = Integer.pow(10, 400)

    for call <- [
          fn -> ImageOps.blur(image, 1.0e9) end,
          fn -> ImageOps.blur(image, 1.0e300) end,
          fn -> ImageOps.blur(image, huge) end,
          fn -> ImageOps.blur(image, -1) end,
          fn -> ImageOps.box_blur(image, huge) end,
          fn -> ImageOps.median_blur(image, -3) end,
          fn -> ImageOps.crop(image, {huge, 0, 1, 1}) end,
          fn -> ImageOps.crop(image, {0, 0, 1.0e300, 1}) end,
          fn -> ImageOps.crop(image, {0, 0, huge, huge}, clip: true) end,
          fn -> ImageOps.resize(image, huge, 2) end,
          fn -> ImageOps.scale(image, 1.0e300, 1) end,
          fn -> ImageOps.scale(image, huge, 1) end,
          fn -> ImageOps.rotate(image, 1.0e300) end,
          fn -> ImageOps.warp_affine(image, [[1, 0, 0], [0, 1, 0]]) end,
          fn -> ImageOps.warp_affine(image, [1, 0, 0]) end,
          fn -> ImageOps.warp_affine(image, [huge, 0, 0, 0, 1, 0]) end,
          fn -> ImageOps.warp_perspective(image, List.duplicate(:a, 9)) end,
          fn -> ImageOps.canny(image, huge, 1) end,
          fn -> ImageOps.canny(image, :low, 1) end,
          fn -> ImageOps.threshold(image, -1) end,
          fn -> ImageOps.convolve(image, [[huge]]) end,
          fn -> ImageOps.convolve(image, [[1.5]]) end,
          fn -> ImageOps.erode(image, huge) end,
          fn -> ImageOps.paste(image, image, {huge, 0}) end,
          fn -> ImageOps.statistics(image, rect: {huge, 0, 1, 1}) end,
          fn -> ImageOps.compare(image, image, tolerance: huge) end,
          fn -> ImageOps.to_f32(image, scale: huge) end
        ] do
      assert {:error, %Situ.Error{}} = call.()
    end
  end

  describe "area" do
    test "is the mean of the covered pixels, weighted by their covered share" do
      image = gray(3, 1, fn x, _ -> elem({0, 90, 240}, x) end)
      # Two output pixels of 1.5 input pixels each: 0 and half of 90, then half of 90 and 240.
      assert ImageOps.resize!(image, 2, 1, filter: :area).data == <<30, 190>>
      assert ImageOps.resize!(image, 1, 1, filter: :area).data == <<110>>
    end

    test "equals the slow reference for every size, format and alpha" do
      for format <- Image.Format.list_all(), {w, h} <- [{7, 5}, {3, 2}, {13, 9}, {17, 4}] do
        size = 13 * 9 * Image.Format.bytes_per_pixel(format)
        data = for i <- 1..size, into: <<>>, do: <<rem(i * i * 7 + i, 256)>>
        image = Image.new!(width: 13, height: 9, format: format, data: data)
        fast = ImageOps.resize!(image, w, h, filter: :area)

        for x <- 0..(w - 1), y <- 0..(h - 1) do
          {:ok, got} = Image.fetch_pixel(fast, x, y)
          wanted = covered(image, {x * 13 / w, (x + 1) * 13 / w}, {y * 9 / h, (y + 1) * 9 / h})

          for {a, b} <- Enum.zip(got, wanted),
              do: assert_in_delta(a, b, 1.01, "#{format} #{w}x#{h} at #{x}, #{y}")
        end
      end
    end

    defp covered(image, {x0, x1}, {y0, y1}) do
      alpha = Enum.find_index(Image.Format.channels(image.format), &(&1 == :alpha))

      weighted =
        for x <- floor(x0)..(ceil(x1) - 1), y <- floor(y0)..(ceil(y1) - 1) do
          {:ok, pixel} = Image.fetch_pixel(image, x, y)
          share = (min(x + 1, x1) - max(x, x0)) * (min(y + 1, y1) - max(y, y0))
          {share, if(alpha, do: Enum.at(pixel, alpha), else: 1), pixel}
        end

      area = weighted |> Enum.map(&elem(&1, 0)) |> Enum.sum()
      opaque = weighted |> Enum.map(fn {s, a, _} -> s * a end) |> Enum.sum()

      for c <- 0..(length(Image.Format.channels(image.format)) - 1) do
        cond do
          c == alpha ->
            opaque / area

          opaque == 0 ->
            0

          true ->
            (weighted |> Enum.map(fn {s, a, p} -> s * a * Enum.at(p, c) end) |> Enum.sum()) /
              opaque
        end
      end
    end
  end

  # A progressive JPEG of one gray image whose last scan is repeated: it is small but takes minutes to decode.
  defp scans(bytes, n) do
    starts = for {at, 2} <- :binary.matches(bytes, <<0xFF, 0xDA>>), do: at
    last = List.last(starts)
    scan = binary_part(bytes, last, byte_size(bytes) - 2 - last)
    binary_part(bytes, 0, last) <> :binary.copy(scan, n) <> <<0xFF, 0xD9>>
  end

  @tag :tmp_dir
  test "rejects a JPEG with thousands of scans immediately", %{tmp_dir: dir} do
    path = Path.join(dir, "p.jpg")
    File.write!(path, progressive())
    assert {:ok, _} = ImageOps.read(path)
    assert {:ok, _} = ImageOps.parse(scans(progressive(), 20))
    assert {:error, error} = ImageOps.parse(scans(progressive(), 5_000))
    assert error.code == :bad_jpeg and error.what =~ "scans"
  end

  # A 16x16 gray image with one DC scan, built by hand because libjpeg-turbo's simple interface writes no progressive
  # files here.
  defp progressive do
    quantization = <<0xFF, 0xDB, 67::16, 0>> <> :binary.copy(<<1>>, 64)
    frame = <<0xFF, 0xC2, 11::16, 8, 16::16, 16::16, 1, 1, 0x11, 0>>
    # One code of one bit: difference 0.
    huffman = <<0xFF, 0xC4, 20::16, 0x00, 1, 0::120, 0>>
    scan = <<0xFF, 0xDA, 8::16, 1, 1, 0x00, 0, 0, 0x00, 0x0F>>
    <<0xFF, 0xD8>> <> quantization <> frame <> huffman <> scan <> <<0xFF, 0xD9>>
  end

  test "cost depends on the file's content and the requested part, not its length or result" do
    alias Situ.ImageOps.CostEstimate
    assert CostEstimate.jpeg_cost(progressive()) > 250
    large = <<0xFF, 0xD8, 0xFF, 0xC0, 11::16, 8, 4000::16, 6000::16, 1, 1, 0x11, 0>>
    assert CostEstimate.jpeg_cost(large) > 10_000
    assert CostEstimate.jpeg_cost("no JPEG") > 250
    small = ImageOps.encode_jpeg!(Image.new_filled(64, 64, :gray8)).data
    assert CostEstimate.jpeg_cost(small) < 250
    twelve = %{Image.new_filled(1, 1, :bgr24) | width: 4000, height: 3000, stride: 12_000}
    assert CostEstimate.resize_cost(twelve, 10, 10, :lanczos) > 50_000
    assert CostEstimate.resize_cost(twelve, 10, 10, :area) > 10_000
    assert CostEstimate.resize_cost(Image.new_filled(64, 64, :bgr24), 32, 32, :lanczos) < 250
  end
end
