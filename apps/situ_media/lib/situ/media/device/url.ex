defmodule Situ.Media.Device.Url do
  @moduledoc """
  Streams from the network that FFmpeg reads: RTSP cameras, UDP and RTP, SRT, HTTP, RTMP.

  The sender's clock is kept between frames (exact steps); the first frame gets the pipeline's time when it arrives.
  """
  @behaviour Situ.Media.Device
  alias Situ.Media.Device

  # Not `file:`, `concat:` or `subfile:`: a URL means the network.
  @schemes ~w(rtsp rtsps rtp udp tcp srt http https rtmp rtmps rtmpt hls mmsh mmst)

  @impl true
  def list, do: []

  @impl true
  def capture(url, _kind, opts) do
    scheme = url |> String.split("://") |> hd() |> String.downcase()

    if scheme in @schemes do
      {:ok, %{args: options(scheme) ++ (opts[:args] || []) ++ ["-i", url], clock: :arrival}}
    else
      Device.driver_error(
        url,
        :bad_option,
        "not a network address FFmpeg reads: #{Enum.join(@schemes, ", ")}"
      )
    end
  end

  # Frames are wanted soon, and a short look at the stream is enough to know it.
  defp options("rtsp" <> _), do: ~w(-rtsp_transport tcp -fflags nobuffer -flags low_delay)
  defp options(_scheme), do: ~w(-fflags nobuffer -flags low_delay -analyzeduration 1000000)
end
