defmodule VideoFixture do
  @moduledoc false
  # Films of 4 s with 25 images per second. The upper part of each image has 12 bars, which state its number in binary,
  # the lowest digit at the left.

  @rate 25

  def create(folder) do
    File.mkdir_p!(folder)

    for {name, args} <- films(), do: encode(Path.join(folder, name), args)
    path = &Path.join(folder, &1)

    # A cut at an image that is not a key frame; the images before it are decoded, but not shown.
    copy(path.("bframes.mp4"), ~w(-ss 1.3), ~w(), path.("cut.mp4"))
    copy(path.("bframes.mp4"), ~w(), ~w(-metadata:s:v rotate=90), path.("turned.mp4"))
    record(path.("bframes.mp4"), "stored", folder, & &1)
    # An odd size
    record(path.("bframes.mp4"), "odd", folder, &Situ.ImageStream.resize(&1, 239, 159))
    folder
  end

  # A recording whose images are stored as video.
  defp record(film, name, folder, change) do
    {:ok, _} =
      Situ.Pipeline.run(
        fn p ->
          store = Situ.Store.create(p, name, folder)
          %{video: images} = Situ.Media.VideoFile.open(p, film, audio: false)

          images
          |> change.()
          |> Situ.Store.write(store, "Video", encode: {:h264, keyframe_every: 1_000_000_000})
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )
  end

  defp films do
    [
      {"bframes.mp4", ~w(-c:v libx264 -preset veryfast -bf 3 -g 40)},
      {"opengop.mkv", ~w(-c:v libx264 -preset veryfast -x264-params open-gop=1:keyint=40)},
      {"uneven.mkv",
       ~w(-c:v libx264 -preset veryfast -g 40 -fps_mode vfr) ++
         ["-vf", "select='not(mod(n,7)*mod(n,3))'"]},
      {"vp9.webm", ~w(-c:v libvpx-vp9 -deadline realtime -cpu-used 8 -g 40)},
      {"av1.mp4", ~w(-c:v libaom-av1 -usage realtime -cpu-used 8 -g 40)},
      {"jpeg.mov", ~w(-c:v mjpeg -q:v 4)},
      {"hevc.mp4", ~w(-c:v libx265 -preset ultrafast -x265-params log-level=none)}
    ]
  end

  defp encode(path, args) do
    bars = "geq=lum='255*mod(floor(N/pow(2,X)),2)',scale=240:48:flags=neighbor"

    run(
      ~w(-f lavfi -i testsrc2=size=240x160:rate=#{@rate}:duration=4) ++
        ~w(-f lavfi -i) ++
        ["color=black:size=12x1:rate=#{@rate}:duration=4,format=gray,#{bars}"] ++
        ["-filter_complex", "[0][1]overlay=0:0,format=yuv420p" <> filter(args)] ++
        (args -- filter_args(args)) ++ [path]
    )
  end

  # FFmpeg takes only one filter for a stream.
  defp filter(args) do
    case filter_args(args) do
      ["-vf", filter] -> "," <> filter
      [] -> ""
    end
  end

  defp filter_args(args) do
    case Enum.find_index(args, &(&1 == "-vf")) do
      nil -> []
      at -> Enum.slice(args, at, 2)
    end
  end

  defp copy(from, before, args, to), do: run(before ++ ["-i", from, "-c", "copy"] ++ args ++ [to])

  defp run(args) do
    {_, 0} = System.cmd("ffmpeg", ~w(-v error -nostdin -y) ++ args)
    :ok
  end
end
