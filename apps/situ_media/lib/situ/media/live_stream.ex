defmodule Situ.Media.LiveStream do
  @moduledoc """
  A live source of images and audio: a network stream, or a simulated device with both.

      live = Situ.Media.LiveStream.open(p, device: "rtsp://camera.local/stream")
      live.video |> Situ.each(&IO.inspect/1)

  Frames keep the sender's time steps; the first frame is stamped with the pipeline's time when it arrives. Images and
  audio share one clock and stay synchronized. Like every device, the source cannot wait: data that the pipeline does
  not take in time is dropped and counted.
  """

  alias Situ.Graph.Placement
  alias Situ.AudioFormat

  @schema [
    device: [
      type: {:or, [:string, {:tuple, [:module, :string]}]},
      required: true,
      doc: "A URL, or any device of `Situ.Media.Device` with images and audio."
    ],
    video: [type: :boolean, default: true, doc: "Capture the images."],
    audio: [type: :boolean, default: true, doc: "Capture the audio."],
    size: [
      type: {:optional, {:tuple, [:pos_integer, :pos_integer]}},
      default: nil,
      doc: "`{width, height}` to scale to; `nil`: as sent."
    ],
    rate: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Maximum images per second; `nil`: all images."
    ],
    format: [type: {:in, Situ.Image.Format.list_all()}, default: :bgr24, doc: "Pixel format."],
    audio_format: [
      type: {:optional, {:struct, AudioFormat}},
      default: nil,
      doc: "Convert the audio to this format; `nil`: 16-bit samples as sent."
    ],
    audio_buffer: [
      type: :pos_integer,
      default: 20_000_000,
      doc: "Length of an audio buffer, ns, if `audio_format:` is given."
    ],
    buffer: [
      type: :pos_integer,
      default: 30,
      doc:
        "Number of messages that may wait for a slow pipeline; beyond it the oldest is dropped."
    ],
    reconnect: [
      type: :boolean,
      default: false,
      doc: "Retry every second when the stream ends or breaks; otherwise the source completes."
    ],
    stall_timeout: [
      type: :pos_integer,
      default: 10_000_000_000,
      doc: "Time without data (ns) after which the stream counts as broken."
    ],
    args: [type: {:list, :string}, default: [], doc: "Additional input options for `ffmpeg`."]
  ]

  use Situ.Component, outputs: [video: Situ.Image, audio: Situ.AudioBuffer], options: @schema
  use Situ.Media.Capture

  @doc "Adds the source and returns `%{video: stream, audio: stream}`, without streams that are turned off."
  @spec open(Situ.Pipeline.t(), keyword()) :: %{atom() => Situ.Stream.t()}
  def open(p, opts) do
    {opts, placed} = Placement.split_options!(opts, @schema, :component)
    ports = for {kind, type} <- outputs(), opts[kind], do: {kind, type}

    node =
      Situ.Pipeline.add(
        p,
        __MODULE__,
        [outputs: ports] ++ opts ++ Keyword.put_new(placed, :async, true)
      )

    Map.new(ports, fn {kind, _} -> {kind, Situ.Node.output(node, kind)} end)
  end

  @impl true
  def init(opts), do: Capture.new(opts[:device], enabled_outputs(opts), opts)

  defp enabled_outputs(opts),
    do: for(kind <- [:video, :audio], opts[kind], into: %{}, do: {kind, kind})
end
