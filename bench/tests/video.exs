defmodule Situ.Bench.Video do
  @moduledoc """
  Video files and live images: the cost of decoding, and whether memory use is stable.

  * `video-decode`: reads a 720p H.264 file as images and audio at full speed.
  * `video-720p`: decodes, resizes, converts to gray and compresses the same file. Prints the
    share of one core that 30 images per second would need, separately for the VM and ffmpeg.
  * `video-steady`: a simulated 720p camera with 30 images per second through resize, gray and
    JPEG in real time, two minutes at scale 1 (ten at scale 5). Prints the VM's memory after a
    fifth of the time and at the end, and the lost images.
  """
  alias Situ.Bench
  alias Situ.Media.{Camera, VideoFile}

  @rate 30

  def tests do
    [
      {"video-decode", &decode/1},
      {"video-720p", &chain/1},
      {"video-steady", &steady/1}
    ]
  end

  defp decode(scale) do
    {file, frames} = clip(scale)
    counter = :counters.new(2, [])

    measured =
      with_ffmpeg_cpu("video_decode", frames, fn ->
        Bench.measure("video_decode", frames, "frame/s", fn ->
          {:ok, _} =
            Situ.Pipeline.run(fn p ->
              clip = VideoFile.open(p, file)
              Situ.each(clip.video, fn _ -> :counters.add(counter, 1, 1) end)

              Situ.each(clip.audio, fn b ->
                :counters.add(counter, 2, Situ.AudioBuffer.frame_count(b))
              end)
            end)
        end)
      end)

    check!(:counters.get(counter, 1), frames, "pictures")
    check!(:counters.get(counter, 2), div(frames * 48_000, @rate), "samples")
    measured
  end

  defp chain(scale) do
    {file, frames} = clip(scale)
    counter = :counters.new(1, [])

    measured =
      with_ffmpeg_cpu("video_720p", frames, fn ->
        Bench.measure("video_720p", frames, "frame/s", fn ->
          {:ok, _} =
            Situ.Pipeline.run(fn p ->
              VideoFile.open(p, file, audio: false).video
              |> small_grey_jpeg()
              |> Situ.each(fn _ -> :counters.add(counter, 1, 1) end)
            end)
        end)
      end)

    check!(:counters.get(counter, 1), frames, "pictures")
    {_, vm, _} = List.keyfind(measured, "video_720p_cpu", 0)
    {_, ffmpeg, _} = List.keyfind(measured, "video_720p_ffmpeg_cpu", 0)
    measured ++ [{"video_720p_core_at_30fps", (vm + ffmpeg) * @rate / 10_000, "%"}]
  end

  defp steady(scale) do
    seconds = max(round(120 * scale), 5)
    {file, _} = clip(1)
    counter = :counters.new(1, [])

    {:ok, pipeline} =
      Situ.Pipeline.start(
        fn p ->
          p
          |> Camera.open(device: "simulated:" <> file, size: nil, name: "Camera")
          |> small_grey_jpeg()
          |> Situ.each(fn _ -> :counters.add(counter, 1, 1) end)
        end,
        []
      )

    Process.sleep(div(seconds * 1000, 5))
    {early, first} = {Bench.rss_mib(), :counters.get(counter, 1)}
    Process.sleep(seconds * 1000 - div(seconds * 1000, 5))
    late = Bench.rss_mib()
    got = :counters.get(counter, 1) - first
    {:ok, _} = Situ.Pipeline.stop(pipeline)
    expected = round((seconds - seconds / 5) * @rate)
    if got < expected * 0.9, do: raise("only #{got} of #{expected} pictures came")
    if late > early + 100, do: raise("memory grew from #{early} to #{late} MiB")

    [
      {"video_steady_rss_early", early, "MiB"},
      {"video_steady_rss_end", late, "MiB"},
      {"video_steady_lost", max(expected - got, 0), "frames"}
    ]
  end

  defp small_grey_jpeg(video) do
    video
    |> Situ.map(&ok!(Situ.ImageOps.resize(&1, 640, 360)))
    |> Situ.map(&ok!(Situ.ImageOps.convert(&1, :gray8)))
    |> Situ.map(&ok!(Situ.ImageOps.encode_jpeg(&1)))
  end

  defp ok!({:ok, value}), do: value

  defp check!(same, same, _what), do: :ok
  defp check!(got, expected, what), do: raise("#{got} #{what} instead of #{expected}")

  # Created once and kept in the temporary folder: moving colors and a tone, 20 s at scale 1.
  defp clip(scale) do
    seconds = max(round(20 * scale), 2)
    file = Path.join(System.tmp_dir!(), "situ-bench-720p-#{seconds}.mkv")

    unless File.exists?(file) do
      {_, 0} =
        System.cmd(
          "ffmpeg",
          ~w(-v error -nostdin -y
          -f lavfi -i testsrc2=size=1280x720:rate=#{@rate}:duration=#{seconds}
          -f lavfi -i sine=duration=#{seconds}:sample_rate=48000
          -c:v libx264 -preset veryfast -pix_fmt yuv420p -c:a flac) ++ [file <> ".part.mkv"]
        )

      File.rename!(file <> ".part.mkv", file)
    end

    {file, seconds * @rate}
  end

  # CPU time of the ended child programs of the VM, as counted by their parent (erl_child_setup).
  defp with_ffmpeg_cpu(metric, frames, fun) do
    before = children_us()
    measured = fun.()
    # The end of the last program is recorded a moment after its output has ended.
    Process.sleep(200)
    measured ++ [{metric <> "_ffmpeg_cpu", (children_us() - before) / frames, "us/msg"}]
  end

  defp children_us do
    [children] =
      File.read!("/proc/self/task/#{System.pid()}/children") |> String.split() |> Enum.take(1)

    [_, fields] = File.read!("/proc/#{children}/stat") |> String.split(") ", parts: 2)
    fields = String.split(fields)
    # cutime and cstime, fields 16 and 17 of the line, in hundredths of a second.
    [utime, stime] = Enum.slice(fields, 13, 2) |> Enum.map(&String.to_integer/1)
    (utime + stime) * 10_000
  end
end
