defmodule Situ.Media.Microphone do
  @moduledoc """
  A microphone as a source of audio buffers, each stamped with the time of its end.

      mic = Situ.Media.Microphone.open(p)
      mic = Situ.Media.Microphone.open(p, device: "simulated:talk1.mp4")

  `Situ.Media.Device` lists the kinds of devices, and `situ devices` lists the available ones. Audio that a slow
  pipeline does not take is kept for 10 s; older audio is dropped and counted. `gain:` changes the captured audio; to
  change the level of the device itself, use the sound system (`pactl set-source-volume`, `alsamixer`).
  """

  alias Situ.AudioFormat
  alias Situ.Media.Device

  @schema [
    device: [
      type: {:or, [:string, {:tuple, [:module, :string]}]},
      default: "pulse:default",
      doc: "The microphone, see `Situ.Media.Device`."
    ],
    audio_format: [
      type: {:struct, AudioFormat},
      default: %AudioFormat{},
      doc: "Format of the audio; default 16 kHz, mono, 16 bit."
    ],
    audio_buffer: [type: :pos_integer, default: 20_000_000, doc: "Length of an audio buffer, ns."],
    gain: [
      type: {:or, [:number, {:tuple, [{:in, [:db]}, :number]}]},
      default: 1.0,
      doc: "Volume as a factor or `{:db, n}`; samples beyond full scale are clipped."
    ],
    buffer: [
      type: :pos_integer,
      default: 500,
      doc: "Number of buffers that may wait for a slow pipeline; beyond it the oldest is dropped."
    ],
    reconnect: [
      type: {:optional, :boolean},
      default: nil,
      doc:
        "Retry every second if the device is lost while running; `nil`: yes, unless the source has an end (`?once`)."
    ],
    stall_timeout: [
      type: :pos_integer,
      default: 10_000_000_000,
      doc: "Time without data (ns) after which the device counts as lost."
    ],
    args: [type: {:list, :string}, default: [], doc: "Additional input options for `ffmpeg`."]
  ]

  use Situ.Component, outputs: [out: Situ.AudioBuffer], options: @schema
  use Situ.Media.Capture

  @doc "Adds the microphone to a pipeline and returns its stream."
  @spec open(Situ.Pipeline.t(), keyword()) :: Situ.Stream.t()
  def open(p, opts \\ []), do: Situ.source(p, __MODULE__, Keyword.put_new(opts, :async, true))

  @doc "Lists the available microphones."
  @spec list_devices() :: [Device.t()]
  def list_devices, do: Enum.filter(Device.list(), &(&1.kind == :microphone))

  @impl true
  def init(opts), do: Capture.new(opts[:device], %{audio: :out}, opts)
end
