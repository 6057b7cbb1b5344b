defmodule Situ.Media.Device.Alsa do
  @moduledoc false
  # Microphones and speakers of the Linux kernel (ALSA). Lists only sound cards; names from `.asoundrc` work too.
  @behaviour Situ.Media.Device
  alias Situ.Media.Device

  @impl true
  def list, do: list_cards("arecord", :microphone) ++ list_cards("aplay", :speaker)

  @impl true
  def capture(address, :microphone, opts) do
    format = opts[:audio_format]

    {:ok,
     %{
       args:
         ~w(-f alsa -sample_rate #{format.rate} -channels #{format.channels}) ++
           (opts[:args] || []) ++ ["-i", address],
       clock: :wall
     }}
  end

  def capture(address, _kind, _opts),
    do: Device.driver_error(address, :bad_option, "a microphone provides audio only")

  @impl true
  def playback(address, _opts), do: {:ok, ["-f", "alsa", address]}

  @impl true
  def help(kind) do
    "list the available devices with `situ devices #{kind}s`; if the card is listed, add your user to the group " <>
      "audio, or close the other program that uses it (pulse:default shares the card)"
  end

  @doc """
  Parses the output of `arecord -l`.

      iex> text = "card 1: PCH [HDA Intel PCH], device 0: ALC256 Analog [ALC256 Analog]\\n"
      iex> for d <- Situ.Media.Device.Alsa.parse_cards(text, :speaker), do: {d.id, d.name}
      [{"alsa:plughw:CARD=PCH,DEV=0", "HDA Intel PCH, ALC256 Analog"}]
  """
  @spec parse_cards(String.t(), Device.kind()) :: [Device.t()]
  def parse_cards(text, kind) do
    for line <- String.split(text, "\n"),
        [_, card, name, device, label] <-
          [Regex.run(~r/^card \d+: (\S+) \[(.*?)\], device (\d+): .*\[(.*?)\]/, line)] do
      %Device{id: "alsa:plughw:CARD=#{card},DEV=#{device}", kind: kind, name: "#{name}, #{label}"}
    end
  end

  defp list_cards(program, kind), do: parse_cards(Device.run_program(program, ["-l"]), kind)
end
