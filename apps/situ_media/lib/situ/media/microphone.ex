defmodule Situ.Media.Microphone do
  alias Situ.AudioFormat
  alias Situ.Media.Device

  @schema [
    device: [
      type: {:or, [:string, {:tuple, [:module, :string]}]},
      default: "pulse:default",
      doc: "Which microphone, see `Situ.Media.Device`."
    ],
    audio_format: [
      type: {:struct, AudioFormat},
      default: %AudioFormat{},
      doc: "The format to deliver; default 16 kHz, mono, 16 bit."
    ],
    audio_buffer: [type: :pos_integer, default: 20_000_000, doc: "Length of one piece, ns."],
    gain: [
      type: {:or, [:number, {:tuple, [{:in, [:db]}, :number]}]},
      default: 1.0,
      doc:
        "Louder or quieter: a factor, or `{:db, n}`; what gets too loud is cut off at full scale."
    ],
    buffer: [
      type: :pos_integer,
      default: 500,
      doc: "Pieces that may wait for a slow pipeline; then the oldest is dropped."
    ],
    reconnect: [
      type: {:optional, :boolean},
      default: nil,
      doc:
        "When the device is lost while it runs, try again every second; `nil`: yes, unless it has an end (`?once`)."
    ],
    stall_timeout: [
      type: :pos_integer,
      default: 10_000_000_000,
      doc: "A device that sends nothing for so long (ns) counts as lost."
    ],
    args: [type: {:list, :string}, default: [], doc: "More input options for `ffmpeg`."]
  ]

  @moduledoc """
  A microphone as a source: sound in pieces, each at the time of its end.

      mic = Situ.Media.Microphone.open(p)
      mic = Situ.Media.Microphone.open(p, device: "simulated:talk1.mp4")

  The kinds of devices: `Situ.Media.Device`; `situ devices` lists the ones that are there. Sound that a slow pipeline
  does not take is kept for 10 s, then dropped from its oldest end, and counted. `gain:` changes the sound that
  arrives; the level of the device itself is the sound system's (`pactl set-source-volume`, `alsamixer`).

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component, outputs: [out: Situ.AudioBuffer], options: @schema
  use Situ.Media.Capture

  @doc "Adds the microphone to a pipeline; returns its stream."
  @spec open(Situ.Pipeline.t(), keyword()) :: Situ.Stream.t()
  def open(p, opts \\ []), do: Situ.source(p, __MODULE__, Keyword.put_new(opts, :async, true))

  @doc "The microphones there are."
  @spec list() :: [Device.t()]
  def list, do: Enum.filter(Device.list(), &(&1.kind == :microphone))

  @impl true
  def init(opts), do: Capture.new(opts[:device], %{audio: :out}, opts)
end
