defmodule Situ.Bench.Kernels do
  @moduledoc """
  Single kernels, called from Elixir in sequence, including call overhead and the binary of the
  result. Prints operations per second by the wall clock, and `_cpu` in microseconds per
  operation. `bench/python/kernels.py` does the same jobs with OpenCV, SciPy and soxr, and prints
  the same names.
  """
  alias Situ.{AudioBuffer, AudioFormat, Bench, Image, ImageOps, AudioOps}

  def tests, do: [{"kernels", &kernels/1}]

  defp kernels(scale) do
    Enum.flat_map(jobs(), fn {name, n, job} ->
      time("kernel_" <> name, max(round(n * scale), 3), job)
    end)
  end

  @doc "Lists the jobs: name, calls at scale 1, and a function that returns whether its result has the right size."
  def jobs do
    hd1080 = picture(1920, 1080)
    hd720 = picture(1280, 720)
    gray1080 = ImageOps.convert!(hd1080, :gray8)
    {:ok, jpeg} = ImageOps.encode_jpeg(hd720, quality: 85)
    sound = sound(480_000)

    [
      {"resize_1080p_640x360", 60, fn -> ImageOps.resize!(hd1080, 640, 360).width == 640 end},
      {"resize_1080p_854x480", 60, fn -> ImageOps.resize!(hd1080, 854, 480).width == 854 end},
      {"bgr_to_gray_1080p", 60, fn -> ImageOps.convert!(hd1080, :gray8).format == :gray8 end},
      {"jpeg_encode_720p", 30, fn -> ImageOps.encode_jpeg!(hd720, quality: 85).width == 1280 end},
      {"jpeg_decode_720p", 30, fn -> ImageOps.parse!(jpeg).width == 1280 end},
      {"gaussian_5x5_gray_1080p", 40,
       fn -> ImageOps.blur!(gray1080, 1.1, size: 5).width == 1920 end},
      {"canny_gray_1080p", 15, fn -> ImageOps.canny!(gray1080, 60, 120).width == 1920 end},
      {"resample_10s_48k_16k", 30,
       fn -> AudioBuffer.frame_count(AudioOps.resample!(sound, 16_000)) == 160_000 end}
    ]
  end

  defp time(metric, n, job) do
    Bench.measure(metric, n, "op/s", fn ->
      unless Enum.all?(1..n, fn _ -> job.() end), do: raise("#{metric}: wrong result")
    end)
  end

  # Smooth and noisy parts, so that JPEG has as much work as with a photograph. The Python script
  # creates the same bytes.
  defp picture(width, height) do
    rows =
      for y <- 0..(height - 1), into: <<>> do
        for x <- 0..(width - 1), into: <<>> do
          noise = rem(x * 7919 + y * 104_729 + x * y, 31)
          <<rem(div(x, 5) + noise, 256), rem(div(y, 4) + noise, 256), rem(div(x + y, 9), 256)>>
        end
      end

    Image.new!(width: width, height: height, format: :bgr24, data: rows)
  end

  defp sound(frames) do
    data =
      for i <- 0..(frames - 1),
          into: <<>>,
          do: <<0.5 * :math.sin(i * i / 1.0e6)::little-float-32>>

    AudioBuffer.new!(format: AudioFormat.pcm(48_000, 1, :f32), data: data)
  end
end
