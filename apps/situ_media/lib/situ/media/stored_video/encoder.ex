defmodule Situ.Media.StoredVideo.Encoder do
  @moduledoc false
  # The component that compresses the images of `Situ.Store.write/4` with `encode:`. It emits one `Situ.VideoPacket` for
  # each image, with its time. It starts another `ffmpeg`, and with it a key frame, when the size or format of the
  # images changes.
  use Situ.Component,
    inputs: [in: Situ.Image],
    outputs: [out: Situ.VideoPacket],
    options: [
      codec: [type: :atom, required: true, doc: "The codec that the user chose."],
      encoder: [type: :keyword, required: true, doc: "See `EncoderOptions.schema/0`."]
    ]

  require Logger
  alias Situ.{Error, Image, VideoPacket}
  alias Situ.Media.FFmpeg.FormatNames
  alias Situ.Media.StoredVideo.{EncoderOptions, Transcoder}

  defstruct [:codec, :encoder, :opts, :coder, :shape, :start, position: 0]

  @impl true
  def init(opts) do
    with {:ok, {codec, encoder}} <- EncoderOptions.choose_encoder(opts[:codec]) do
      if codec != opts[:codec], do: warn_of_codec(opts[:codec], codec)
      {:ok, %__MODULE__{codec: codec, encoder: encoder, opts: opts[:encoder]}}
    end
  end

  defp warn_of_codec(wanted, codec) do
    Logger.warning(
      "Images are recorded as #{inspect(codec)}, because the installed FFmpeg has no encoder for #{inspect(wanted)}"
    )
  end

  @impl true
  def handle_message(:in, %{data: image, originating_time: time}, _context, state) do
    image = Error.unwrap!(Image.validate(image))
    :ok = Error.unwrap!(EncoderOptions.check_image(image))
    state = ensure_coder(state, image, time)
    elapsed = time - state.start

    with :ok <- Transcoder.write_frame(state.coder, elapsed, Image.pixel_bytes(image), true),
         {:ok, frame, coder} <- Transcoder.read_frame(state.coder) do
      position = if frame.key?, do: 0, else: state.position + 1
      packet = build_packet(state, image, position, frame.data)
      {[{:out, time, packet}], %{state | coder: coder, position: position}}
    else
      {:error, error} ->
        raise error

      :eof ->
        raise Error.new(:cannot_encode, "#{state.encoder} ended without a packet for an image")
    end
  end

  defp build_packet(state, image, position, data) do
    %VideoPacket{
      codec: state.codec,
      position: position,
      width: image.width,
      height: image.height,
      format: image.format,
      data: data
    }
  end

  defp ensure_coder(state, image, time) do
    shape = {image.width, image.height, image.format}
    if shape == state.shape, do: state, else: start_coder(close_coder(state), shape, image, time)
  end

  defp start_coder(state, shape, image, time) do
    stream = %{
      fourcc: FormatNames.fourcc(image.format),
      width: image.width,
      height: image.height
    }

    args = EncoderOptions.build_args(state.encoder, image, state.opts)
    coder = Error.unwrap!(Transcoder.start_link(stream, args, "the encoder #{state.encoder}"))
    %{state | coder: coder, shape: shape, start: time}
  end

  defp close_coder(%{coder: nil} = state), do: state

  defp close_coder(state) do
    Transcoder.close(state.coder)
    %{state | coder: nil}
  end

  @impl true
  def terminate(_reason, state) do
    _ = close_coder(state)
    :ok
  end
end
