defmodule Situ.Media.Device.Pulse do
  @moduledoc false
  # Microphones and speakers of PulseAudio, or of PipeWire, which implements its protocol. Times are wall time, smoothed
  # over the device's own clock.
  @behaviour Situ.Media.Device
  alias Situ.Media.Device

  @impl true
  def list, do: list_kind(:microphone, "-sources") ++ list_kind(:speaker, "-sinks")

  @impl true
  def capture(address, :microphone, opts) do
    format = opts[:audio_format]
    # Requests half a buffer at a time, so that a buffer is complete soon after its end.
    fragment =
      max(
        div(
          Situ.AudioFormat.bytes_per_second(%{format | sample: :s16}) * opts[:audio_buffer],
          2_000_000_000
        ),
        64
      )

    {:ok,
     %{
       args:
         ~w(-f pulse -name situ -sample_rate #{format.rate} -channels #{format.channels}) ++
           ["-fragment_size", to_string(fragment)] ++ (opts[:args] || []) ++ ["-i", address],
       clock: :wall
     }}
  end

  def capture(address, _kind, _opts),
    do: Device.driver_error(address, :bad_option, "a microphone provides audio only")

  @impl true
  def playback(address, opts) do
    {:ok,
     [
       "-f",
       "pulse",
       "-name",
       "situ",
       "-buffer_duration",
       "#{div(opts[:latency], 1_000_000)}",
       "-device",
       address,
       "situ"
     ]}
  end

  @impl true
  def help(kind) do
    "list the available devices with `situ devices #{kind}s`; if there are none, start PulseAudio or PipeWire for " <>
      "this user, or use a device of another driver (alsa:default)"
  end

  @doc """
  Parses the output of `ffmpeg -sources pulse`.

      iex> text = "Auto-detected sources for pulse:\\n* virt.monitor [Monitor of Null Output] (none)\\n  mic [Mic]\\n"
      iex> for d <- Situ.Media.Device.Pulse.parse_devices(text, :microphone), do: {d.id, d.name, d.default?}
      [{"pulse:virt.monitor", "Monitor of Null Output", true}, {"pulse:mic", "Mic", false}]
  """
  @spec parse_devices(String.t(), Device.kind(), String.t()) :: [Device.t()]
  def parse_devices(text, kind, driver \\ "pulse") do
    for line <- String.split(text, "\n"),
        [_, star, address, name] <- [Regex.run(~r/^([* ]) (\S+) \[(.*?)\]/, line)] do
      %Device{id: "#{driver}:#{address}", kind: kind, name: name, default?: star == "*"}
    end
  end

  defp list_kind(kind, option),
    do: parse_devices(Device.run_program("ffmpeg", ["-hide_banner", option, "pulse"]), kind)
end
