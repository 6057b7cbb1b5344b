defmodule Situ.Media.StoredVideo.PacketDecoder do
  @moduledoc false
  # Decodes the packets of a recording one by one, from a key frame on. The images depend only on the packets.
  alias Situ.{Image, VideoPacket}
  alias Situ.Media.FFmpeg
  alias Situ.Media.FFmpeg.FormatNames
  alias Situ.Media.StoredVideo.{EncoderOptions, Transcoder}

  # `position` is where the packet after the last one begins.
  @enforce_keys [:coder, :shape]
  defstruct [:coder, :shape, position: 0, ticks: 0]
  @type t :: %__MODULE__{}

  # Each packet has its own time in the decoder.
  @tick_ns 1_000_000
  @fourcc %{h264: "H264", vp8: "VP80", vp9: "VP90"}

  @doc "Starts a decoder for packets like `packet`. The images of the first `skipped` packets are not returned."
  @spec open(VideoPacket.t(), non_neg_integer()) :: {:ok, t()} | {:error, Situ.Error.t()}
  def open(packet, skipped) do
    stream = %{
      fourcc: @fourcc[packet.codec],
      width: packet.width + rem(packet.width, 2),
      height: packet.height + rem(packet.height, 2)
    }

    # With threads that decode different images, an image would come late. Threads for its parts do not delay it.
    input = ~w(-thread_type slice -max_pixels 67108864)

    with {:ok, coder} <-
           Transcoder.start_link(stream, output_args(packet, skipped), "a video", input),
         do: {:ok, %__MODULE__{coder: coder, shape: shape_of(packet)}}
  end

  defp output_args(%{width: w, height: h} = packet, skipped) do
    filters =
      "trim=start_frame=#{skipped},scale=flags=#{EncoderOptions.scale_flags()}," <>
        "format=#{FormatNames.ffmpeg(packet.format)},crop=#{w}:#{h}:0:0:exact=1"

    ["-vf", filters] ++
      ~w(-threads 1 -c:v rawvideo -fps_mode passthrough) ++
      ~w(-enc_time_base:v #{FFmpeg.input_time_base()})
  end

  @doc "Returns whether the decoder takes this packet now. A key frame of another size needs another decoder."
  @spec accepts?(t(), VideoPacket.t()) :: boolean()
  def accepts?(decoder, packet),
    do: shape_of(packet) == decoder.shape and packet.position in [0, decoder.position]

  defp shape_of(packet), do: {packet.codec, packet.width, packet.height, packet.format}

  @doc "Gives the decoder a packet whose image it skips."
  @spec skip(t(), VideoPacket.t()) :: {:ok, t()} | {:error, Situ.Error.t()}
  def skip(decoder, packet) do
    key? = VideoPacket.key?(packet)

    with :ok <-
           Transcoder.write_frame(decoder.coder, decoder.ticks * @tick_ns, packet.data, key?),
         do: {:ok, %{decoder | ticks: decoder.ticks + 1, position: packet.position + 1}}
  end

  @doc "Decodes a packet."
  @spec decode(t(), VideoPacket.t()) :: {:ok, Image.t(), t()} | {:error, Situ.Error.t()}
  def decode(decoder, packet) do
    with {:ok, decoder} <- skip(decoder, packet),
         {:ok, frame, coder} <- Transcoder.read_frame(decoder.coder),
         do: {:ok, build_image(packet, frame.data), %{decoder | coder: coder}}
  end

  defp build_image(packet, data) do
    %Image{
      width: packet.width,
      height: packet.height,
      format: packet.format,
      stride: packet.width * Image.Format.bytes_per_pixel(packet.format),
      data: data
    }
  end

  @doc "Stops the decoder."
  @spec close(t()) :: :ok
  def close(decoder), do: Transcoder.close(decoder.coder)
end
