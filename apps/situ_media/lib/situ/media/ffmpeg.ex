defmodule Situ.Media.FFmpeg do
  @moduledoc false
  # Finds and starts the programs `ffmpeg` and `ffprobe`. Decoders process untrusted bytes, so each runs in a separate
  # operating system process, where a crash cannot take the VM down. `Situ.Media.FFmpeg.Reader` reads the decoded data
  # from a local socket on demand, so a slow pipeline slows the decoder down and no data accumulates.
  # See docs/adr/0050-ffmpeg-runs-in-a-separate-process.md.
  alias Situ.Error

  # Limits each allocation inside ffmpeg, whatever a header claims.
  @max_alloc 1_073_741_824

  @doc """
  Returns the full path of `program` (`"ffmpeg"` or `"ffprobe"`).

      iex> {:ok, path} = Situ.Media.FFmpeg.fetch_executable("ffmpeg")
      iex> Path.basename(path)
      "ffmpeg"
  """
  @spec fetch_executable(String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def fetch_executable(program) when is_binary(program) do
    case System.find_executable(program) do
      nil ->
        {:error,
         Error.new(:no_ffmpeg, "the program #{program} is not installed",
           why: "FFmpeg reads and writes video files, network streams and devices",
           fix: "install it: apt-get install ffmpeg"
         )}

      path ->
        {:ok, path}
    end
  end

  @doc "Returns the options of every `ffmpeg` command: errors only, no keyboard, limited allocations."
  @spec global_options() :: [String.t()]
  def global_options do
    ~w(-hide_banner -nostdin -loglevel level+error -max_alloc #{@max_alloc} -y)
  end

  @doc """
  Returns the installed FFmpeg's name for the encoder time base "same as the input". It was a number before version 6.1
  and is a word since then; version 8 no longer accepts the number.

      iex> Situ.Media.FFmpeg.input_time_base("ffmpeg version 5.1.9-0+deb12u1 Copyright (c) ...")
      "-1"
      iex> Situ.Media.FFmpeg.input_time_base("ffmpeg version N-117100-g0fc6f6b Copyright (c) ...")
      "demux"
  """
  @spec input_time_base(String.t()) :: String.t()
  def input_time_base(banner \\ version_banner()) do
    case Regex.run(~r/version n?(\d+)\./, banner) do
      [_, major] when major in ["4", "5", "6"] -> "-1"
      _ -> "demux"
    end
  end

  # Runs each program once, because its version does not change while the VM is running.
  defp version_banner do
    path = System.find_executable("ffmpeg")
    key = {__MODULE__, path}

    with nil <- :persistent_term.get(key, nil) do
      {banner, _} = System.cmd(path, ["-version"], stderr_to_stdout: true)
      :persistent_term.put(key, banner)
      banner
    end
  end

  # The FFmpeg demuxers that may read a file with these extensions. None of them opens other files that the content
  # names, as playlists (HLS, DASH, concat) do.
  @demuxers [
    {~w(.mp4 .m4v .mov .m4a .3gp .3g2 .mj2), ~w(mov)},
    {~w(.mkv .webm .mka .mk3d), ~w(matroska)},
    {~w(.avi), ~w(avi)},
    {~w(.mpg .mpeg .vob), ~w(mpeg mpegvideo mpegts)},
    {~w(.ts .m2ts .mts), ~w(mpegts)},
    {~w(.flv), ~w(flv live_flv)},
    {~w(.wmv .wma .asf), ~w(asf)},
    {~w(.ogg .ogv .oga .opus .spx), ~w(ogg)},
    {~w(.mp3), ~w(mp3)},
    {~w(.aac), ~w(aac)},
    {~w(.flac), ~w(flac)},
    {~w(.wav .w64), ~w(wav w64)},
    {~w(.aiff .aif .aifc), ~w(aiff)},
    {~w(.caf), ~w(caf)},
    {~w(.au .snd), ~w(au)},
    {~w(.amr), ~w(amr)},
    {~w(.nut), ~w(nut)},
    {~w(.y4m), ~w(yuv4mpegpipe)},
    {~w(.h264 .264), ~w(h264)},
    {~w(.hevc .265), ~w(hevc)},
    {~w(.mjpeg .mjpg), ~w(mjpeg)},
    {~w(.gif), ~w(gif)}
  ]
  @all_demuxers @demuxers |> Enum.flat_map(&elem(&1, 1)) |> Enum.uniq()

  @doc """
  Returns input options that confine a local file. Only the formats of its extension are tried (or, for an unknown
  extension, all formats that contain audio or images themselves), and the file cannot refer to other files or the
  network.

      iex> Situ.Media.FFmpeg.local_file("-odd:name.mp4")
      ["-protocol_whitelist", "file,crypto,data", "-format_whitelist", "mov", "-i", "file:-odd:name.mp4"]
  """
  @spec local_file(Path.t()) :: [String.t()]
  def local_file(path) do
    ~w(-protocol_whitelist file,crypto,data -format_whitelist #{allowed_formats(path)} -i) ++
      ["file:" <> path]
  end

  defp allowed_formats(path) do
    ending = path |> Path.extname() |> String.downcase()

    @demuxers
    |> Enum.find_value(@all_demuxers, fn {endings, demuxers} -> ending in endings && demuxers end)
    |> Enum.join(",")
  end

  # Ties the lifetime of a program to the port. When the port closes (its owner or the VM ended), the shell's standard
  # input ends and the program is killed. Without this, a program that waits for a camera would run forever.
  @bound """
  exec 3<&0
  "$@" </dev/null 3<&- &
  pid=$!
  ( read -r _ <&3; kill -KILL $pid ) >/dev/null 2>&1 &
  guard=$!
  exec 3<&-
  wait $pid
  status=$?
  kill $guard 2>/dev/null
  exit $status
  """

  # Runs a program that ends after its input does, so that the output is finished even if the VM dies.
  @free ~S(exec "$@" </dev/null)

  @doc """
  Starts `program` with `args`. Its messages arrive at the caller as `{port, {:data, {:eol | :noeol, line}}}`, followed
  by `{port, {:exit_status, status}}`.

  With `bound: true` (the default) the program is killed when the port closes.
  """
  @spec start_program(Path.t(), [String.t()], bound: boolean()) :: port()
  def start_program(program, args, opts \\ []) do
    script = if Keyword.get(opts, :bound, true), do: @bound, else: @free

    Port.open({:spawn_executable, "/bin/sh"}, [
      :binary,
      :exit_status,
      :stderr_to_stdout,
      :hide,
      line: 2048,
      args: ["-c", script, "situ-media", program | args]
    ])
  end
end
