defmodule Situ.Media.LiveStream do
  alias Situ.Graph.Placement
  alias Situ.AudioFormat

  @schema [
    device: [
      type: {:or, [:string, {:tuple, [:module, :string]}]},
      required: true,
      doc: "A URL, or any device of `Situ.Media.Device` that gives pictures and sound."
    ],
    video: [type: :boolean, default: true, doc: "Take the pictures."],
    audio: [type: :boolean, default: true, doc: "Take the sound."],
    size: [
      type: {:optional, {:tuple, [:pos_integer, :pos_integer]}},
      default: nil,
      doc: "`{width, height}` to scale to; `nil`: as sent."
    ],
    rate: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "At most so many pictures a second; `nil`: all."
    ],
    format: [type: {:in, Situ.Image.Format.all()}, default: :bgr24, doc: "Pixel format."],
    audio_format: [
      type: {:optional, {:struct, AudioFormat}},
      default: nil,
      doc: "Convert the sound to this; `nil`: 16-bit samples as sent."
    ],
    audio_buffer: [
      type: :pos_integer,
      default: 20_000_000,
      doc: "Length of one piece of sound, ns, when `audio_format:` is given."
    ],
    buffer: [
      type: :pos_integer,
      default: 30,
      doc: "Messages that may wait for a slow pipeline; then the oldest is dropped."
    ],
    reconnect: [
      type: :boolean,
      default: false,
      doc: "When the stream ends or breaks, try again every second; else the source completes."
    ],
    stall_timeout: [
      type: :pos_integer,
      default: 10_000_000_000,
      doc: "A stream that sends nothing for so long (ns) is broken."
    ],
    args: [type: {:list, :string}, default: [], doc: "More input options for `ffmpeg`."]
  ]

  @moduledoc """
  A live source with pictures and sound: a network stream, or a simulated device with both.

      live = Situ.Media.LiveStream.open(p, device: "rtsp://camera.local/stream")
      live.video |> Situ.each(&IO.inspect/1)

  Frames keep the distances the sender gave them; the first gets the pipeline's time when it arrives. Pictures and sound
  share one clock and stay in step. Like every device it cannot wait: what is not taken in time is dropped and counted.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component, outputs: [video: Situ.Image, audio: Situ.AudioBuffer], options: @schema
  use Situ.Media.Capture

  @doc "Adds the source; returns `%{video: stream, audio: stream}`, without what was turned off."
  @spec open(Situ.Pipeline.t(), keyword()) :: %{atom() => Situ.Stream.t()}
  def open(p, opts) do
    {opts, placed} = Placement.split!(opts, @schema, :component)
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
  def init(opts), do: Capture.new(opts[:device], wanted(opts), opts)

  defp wanted(opts), do: for(kind <- [:video, :audio], opts[kind], into: %{}, do: {kind, kind})
end
