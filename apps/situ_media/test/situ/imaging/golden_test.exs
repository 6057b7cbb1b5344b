defmodule Situ.ImageOps.GoldenTest do
  # Compares kernels with the output of NumPy, OpenCV, Pillow, SciPy and soxr: priv/golden/make_golden.py.
  use ExUnit.Case, async: true
  alias Situ.{AudioBuffer, AudioFormat, Image, ImageOps, AudioOps}

  @dir Application.app_dir(:situ_media, "priv/golden")

  defp golden(name), do: ImageOps.read!(Path.join(@dir, name <> ".png"), format: :bgr24)
  defp gray(name), do: ImageOps.read!(Path.join(@dir, name <> ".png"))

  defp numbers,
    do: @dir |> Path.join("numbers.json") |> File.read!() |> Situ.JSON.decode() |> elem(1)

  # No channel value may differ by more than `tolerance`, except for a fraction `outliers`.
  defp assert_same(got, golden, tolerance, outliers \\ 0.0) do
    got = if golden.format == :gray8, do: got, else: ImageOps.convert!(got, :bgr24)
    {:ok, result} = ImageOps.compare(got, golden, tolerance: tolerance, outliers: outliers)
    assert result.equal?, inspect(result)
  end

  setup_all do
    source = ImageOps.read!(Path.join(@dir, "source.png"), format: :bgr24)
    %{source: source, gray: ImageOps.convert!(source, :gray8)}
  end

  test "gray matches \\psi's exactly", %{source: source} do
    assert_same(ImageOps.convert!(source, :gray8), gray("gray"), 0)
    assert_same(source |> ImageOps.convert!(:rgb24) |> ImageOps.convert!(:gray8), gray("gray"), 0)

    assert_same(
      source |> ImageOps.convert!(:bgra32) |> ImageOps.convert!(:gray8),
      gray("gray"),
      0
    )
  end

  describe "resize equals" do
    test "OpenCV's INTER_LINEAR within 1", %{source: source} do
      assert_same(ImageOps.resize!(source, 80, 60), golden("resize_bilinear_opencv"), 1)
      assert_same(ImageOps.resize!(source, 288, 192), golden("resize_up_bilinear_opencv"), 1)
    end

    test "OpenCV's INTER_AREA for integer factors within 1", %{source: source} do
      assert_same(
        ImageOps.resize!(source, 96, 64, filter: :area),
        golden("resize_area_opencv"),
        1
      )
    end

    test "Pillow's bilinear within 1, Lanczos except for 1 value in 1000, nearest exactly", %{
      source: source
    } do
      assert_same(
        ImageOps.resize!(source, 80, 60, filter: :smooth),
        golden("resize_smooth_pillow"),
        1
      )

      assert_same(
        ImageOps.resize!(source, 80, 60, filter: :lanczos),
        golden("resize_lanczos_pillow"),
        1,
        0.001
      )

      assert_same(
        ImageOps.resize!(source, 64, 32, filter: :nearest),
        golden("resize_nearest_pillow"),
        0
      )
    end

    test "itself for 16-bit and strided images", %{gray: gray} do
      wide =
        gray
        |> ImageOps.convert!(:gray16)
        |> ImageOps.resize!(80, 60)
        |> ImageOps.convert!(:gray8)

      assert_same(wide, ImageOps.resize!(gray, 80, 60), 1)
      # A view into the complete image: same stride, no copy, odd offset.
      offset = 3 * gray.stride + 5
      data = binary_part(gray.data, offset, byte_size(gray.data) - offset)
      view = %{gray | width: 101, height: 99, data: data}
      part = ImageOps.crop!(gray, {5, 3, 101, 99})
      assert ImageOps.resize!(view, 31, 17) == ImageOps.resize!(part, 31, 17)
    end
  end

  describe "matches OpenCV's own" do
    # Two releases of OpenCV: their fixed-point interpolation differs by 1 or 2 in places.
    test "warps", %{source: source} do
      matrix = [0.9, -0.3, 20.5, 0.25, 1.1, -10.25]
      warped = ImageOps.warp_affine!(source, matrix, color: [10, 20, 30])
      assert_same(warped, golden("warp_affine"), 2, 0.002)
      perspective = ImageOps.warp_perspective!(source, numbers()["perspective"])
      assert_same(perspective, golden("warp_perspective"), 2, 0.002)
    end

    test "blurs", %{source: source} do
      assert_same(ImageOps.blur!(source, 1.4), golden("blur"), 1)
      assert_same(ImageOps.box_blur!(source, 5), golden("box_blur"), 1)
      assert_same(ImageOps.median_blur!(source, 5), golden("median_blur"), 0)
    end

    test "edges and shapes", %{gray: gray} do
      assert_same(ImageOps.canny!(gray, 60, 120), gray("canny"), 0, 0.001)
      assert_same(ImageOps.sobel!(gray), gray("sobel"), 1)
      assert_same(ImageOps.erode!(gray, 3), gray("erode"), 0)
      assert_same(ImageOps.close!(gray, 3), gray("close"), 0)
      assert_same(ImageOps.equalize!(gray), gray("equalize"), 1)
    end
  end

  test "rotation by a quarter turn matches Pillow's exactly", %{source: source} do
    assert_same(ImageOps.rotate!(source, 90), golden("rotate_pillow_90"), 0)
  end

  test "convolution divides by the taps inside the image", %{gray: gray} do
    kernel = [[1, 2, 1], [0, 5, 0], [-1, -2, -1]]
    assert_same(ImageOps.convolve!(gray, kernel), gray("convolve"), 0)
  end

  test "decodes a JPEG like Pillow, within 2" do
    jpeg = File.read!(Path.join(@dir, "source.jpg"))
    assert_same(ImageOps.parse!(jpeg), golden("jpeg_decoded_pillow"), 2)
  end

  test "converts raw camera frames like OpenCV, within 1" do
    i420 = File.read!(Path.join(@dir, "frame.i420"))
    assert_same(ImageOps.from_yuv!(i420, 192, 128, :i420), golden("i420_opencv"), 1)
    <<luma::binary-size(24_576), u::binary-size(6144), v::binary>> = i420

    pairs =
      for {u, v} <- Enum.zip(:binary.bin_to_list(u), :binary.bin_to_list(v)),
          into: <<>>,
          do: <<u, v>>

    assert ImageOps.from_yuv!(luma <> pairs, 192, 128, :nv12) ==
             ImageOps.from_yuv!(i420, 192, 128, :i420)

    assert {:error, %{code: :bad_image}} = ImageOps.from_yuv(luma, 192, 128, :nv12)
    assert {:error, %{code: :bad_image}} = ImageOps.from_yuv(<<0::72>>, 3, 2, :i420)
    assert {:error, %{code: :too_large}} = ImageOps.from_yuv("", 100_000, 100_000, :nv12)
  end

  test "our own JPEG is close to its source", %{source: source} do
    {:ok, jpeg} = ImageOps.encode_jpeg(source, quality: 95, subsampling: :full)
    {:ok, back} = ImageOps.parse(jpeg)
    assert {:ok, %{mean: mean}} = ImageOps.compare(back, source)
    assert mean < 2.5
  end

  test "16-bit depth survives OpenCV's PNG", %{gray: gray} do
    {:ok, depth} =
      @dir |> Path.join("depth.png") |> File.read!() |> ImageOps.decode_depth(scale: 0.002)

    {:ok, [value]} = Image.fetch_pixel(gray, 50, 40)
    assert {:ok, metres} = Situ.DepthImage.fetch_distance(depth, 50, 40)
    assert_in_delta metres, value * 20 * 0.002, 1.0e-9
    {:ok, png} = ImageOps.encode_png(depth)
    assert {:ok, ^depth} = ImageOps.decode_depth(png, scale: 0.002)
  end

  test "statistics and histogram match NumPy's", %{source: source} do
    {:ok, statistics} = ImageOps.statistics(source)

    for {name, golden} <- Enum.zip([:blue, :green, :red], numbers()["channels"]) do
      got = statistics[name]
      assert {got.min, got.max} == {golden["min"], golden["max"]}
      assert_in_delta got.mean, golden["mean"], 1.0e-9
      assert_in_delta got.deviation, golden["deviation"], 1.0e-6
    end

    {:ok, %{blue: blue}} = ImageOps.histogram(source)
    assert blue == numbers()["histogram_blue"]
  end

  describe "audio" do
    test "resampling matches soxr's" do
      got = AudioOps.resample!(sound("sweep_48k.f32", 48_000), 16_000)
      golden = sound("sweep_16k.f32", 16_000)
      assert AudioBuffer.frame_count(got) == AudioBuffer.frame_count(golden)
      pairs = Enum.zip(AudioBuffer.to_samples(got), AudioBuffer.to_samples(golden))
      assert Enum.all?(pairs, fn {a, b} -> abs(a - b) < 1.0e-4 end)
    end

    test "log-mel and MFCC match NumPy's and SciPy's" do
      buffer = AudioBuffer.slice_frames(sound("sweep_16k.f32", 16_000), 0, 400)

      {:ok, analyzer} =
        Situ.AudioStream.Analyzer.new(buffer.format, dither: 0, mel_bands: 40, mfcc: 13)

      {:ok, [frame]} = Situ.AudioStream.Analyzer.extract_features(analyzer, buffer)

      for {a, b} <- Enum.zip(frame.log_mel, numbers()["log_mel"]),
          do: assert_in_delta(a, b, 1.0e-4)

      for {a, b} <- Enum.zip(frame.mfcc, numbers()["mfcc"]), do: assert_in_delta(a, b, 1.0e-3)
    end

    defp sound(name, rate) do
      data = File.read!(Path.join(@dir, name))
      AudioBuffer.new!(format: AudioFormat.pcm(rate, 1, :f32), data: data)
    end
  end
end
