defmodule Situ.Media.Device.Url do
  @moduledoc false
  # Network streams that FFmpeg can read: RTSP cameras, UDP and RTP, SRT, HTTP, RTMP.
  @behaviour Situ.Media.Device
  alias Situ.Media.Device

  # Excludes `file:`, `concat:` and `subfile:`, because a URL must refer to the network.
  @schemes ~w(rtsp rtsps rtp udp tcp srt http https rtmp rtmps rtmpt hls mmsh mmst)

  @impl true
  def list, do: []

  @impl true
  def capture(url, _kind, opts) do
    scheme = url |> String.split("://") |> hd() |> String.downcase()

    if scheme in @schemes do
      {:ok, %{args: input_options(scheme) ++ (opts[:args] || []) ++ ["-i", url], clock: :arrival}}
    else
      Device.driver_error(
        url,
        :bad_option,
        "the scheme of a network stream must be one of #{Enum.join(@schemes, ", ")}"
      )
    end
  end

  # Minimizes the delay; a short analysis is enough to identify the stream.
  defp input_options("rtsp" <> _), do: ~w(-rtsp_transport tcp -fflags nobuffer -flags low_delay)
  defp input_options(_scheme), do: ~w(-fflags nobuffer -flags low_delay -analyzeduration 1000000)
end
