defmodule Situ.Media.Speaker do
  @moduledoc """
  A sink that plays audio.

      clip.audio |> Situ.Media.Speaker.play()

  Audio buffers are played as they arrive, one after the other. The first buffer sets the format; a later buffer with
  another format reopens the device. The speaker consumes audio at playback speed, so it slows down a pipeline that runs
  faster than real time. To change the device's own volume, use the sound system (`pactl set-sink-volume`, `alsamixer`).
  """

  alias Situ.{AudioBuffer, AudioFormat, AudioOps}
  alias Situ.Media.Device
  alias Situ.Media.FFmpeg.FormatNames
  alias Situ.Media.FFmpeg.Writer

  @schema [
    device: [
      type: {:or, [:string, {:tuple, [:module, :string]}]},
      default: "pulse:default",
      doc: "The speaker, see `Situ.Media.Device`."
    ],
    latency: [
      type: :pos_integer,
      default: 100_000_000,
      doc:
        "Audio buffered by the device, ns. Smaller values reduce delay, larger ones tolerate a busy machine."
    ],
    gain: [
      type: {:or, [:number, {:tuple, [{:in, [:db]}, :number]}]},
      default: 1.0,
      doc: "Volume as a factor or `{:db, n}`; samples beyond full scale are clipped."
    ]
  ]

  use Situ.Component, inputs: [in: AudioBuffer], options: @schema

  @doc "Connects the speaker to `stream` and returns `stream`."
  @spec play(Situ.Stream.t(), keyword()) :: Situ.Stream.t()
  def play(stream, opts \\ []) do
    Situ.via(stream, __MODULE__, opts)
    stream
  end

  @doc "Lists the available speakers."
  @spec list_devices() :: [Device.t()]
  def list_devices, do: Enum.filter(Device.list(), &(&1.kind == :speaker))

  @impl true
  def init(opts) do
    with {:ok, {driver, address}} <- Device.parse_name(opts[:device]),
         :ok <- can_play(driver, address) do
      {:ok, %{driver: driver, address: address, opts: opts, writer: nil, format: nil, played: 0}}
    end
  end

  @impl true
  def handle_message(:in, %{data: %AudioBuffer{} = buffer}, _context, state) do
    state = ensure_open(buffer.format, state)
    buffer = apply_gain(buffer, state.opts[:gain])
    time = AudioFormat.frames_to_ns(buffer.format, state.played)

    case Writer.write_frame(state.writer, 0, time, buffer.data) do
      :ok -> {[], %{state | played: state.played + AudioBuffer.frame_count(buffer)}}
      {:error, error} -> raise open_error(error, state)
    end
  end

  defp apply_gain(buffer, gain) when gain in [1, 1.0], do: buffer
  defp apply_gain(buffer, gain), do: AudioOps.gain!(buffer, gain)

  @impl true
  def handle_closed(:in, _time, _context, state), do: {[], close_writer(state)}

  @impl true
  def terminate(_reason, state), do: close_writer(state)

  defp ensure_open(format, %{format: format, writer: writer} = state) when is_pid(writer),
    do: state

  defp ensure_open(%AudioFormat{} = format, state) do
    state = close_writer(state)

    with {:ok, args} <- state.driver.playback(state.address, state.opts),
         {:ok, writer} <-
           Writer.start_link(
             streams: [
               %{
                 id: 0,
                 class: :audio,
                 fourcc: FormatNames.fourcc(format.sample),
                 rate: format.rate,
                 channels: format.channels
               }
             ],
             args: ~w(-c:a pcm_s16le) ++ args,
             name: state.address,
             buffer: 4_096,
             bound: true
           ) do
      %{state | writer: writer, format: format, played: 0}
    else
      {:error, error} -> raise open_error(error, state)
    end
  end

  # Waits until the last buffer was played.
  defp close_writer(%{writer: nil} = state), do: state

  defp close_writer(state) do
    case Writer.finish_output(state.writer, 30_000) do
      :ok -> %{state | writer: nil}
      {:error, error} -> raise open_error(error, state)
    end
  end

  # FFmpeg opens a device when it writes the "header", so an error there means that the device did not open.
  defp open_error(%{meta: %{log: log}} = error, state) do
    if Enum.any?(log, &(&1 =~ "write header")),
      do: Device.open_error(error, state.driver, state.address, :speaker),
      else: error
  end

  defp open_error(error, _state), do: error

  defp can_play(driver, address) do
    if Code.ensure_loaded?(driver) and function_exported?(driver, :playback, 2),
      do: :ok,
      else: Device.driver_error(address, :bad_option, "this device does not support playback")
  end
end
