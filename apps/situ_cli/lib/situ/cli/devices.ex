defmodule Situ.CLI.Devices do
  @moduledoc "`situ devices`: the cameras, microphones and speakers there are."
  @behaviour Situ.CLI.Command

  alias Situ.Media.Device

  @switches [json: :boolean, modes: :boolean]
  @kinds %{"cameras" => :camera, "microphones" => :microphone, "speakers" => :speaker}

  @impl true
  def name, do: "devices"

  @impl true
  def summary, do: "list cameras, microphones and speakers"

  @impl true
  def usage do
    """
    Usage: situ devices [cameras | microphones | speakers] [OPTIONS]

    Lists what Situ.Media.Camera, Microphone and Speaker can open on this machine: V4L2 cameras, and the sound devices of
    PulseAudio (PipeWire) and ALSA. The first column is what the option `device:` takes; * marks the default. Without any
    hardware, "simulated:FILE" replays a file as a camera and a microphone.

      --modes   also the sizes and rates of each camera
      --json    one JSON array, for programs

    Exit status: 0 listed (also when there is nothing), 2 wrong usage.

    Example: situ devices cameras --modes
    """
  end

  @impl true
  def run(argv) do
    case OptionParser.parse(argv, strict: @switches) do
      {opts, [], []} -> show(Device.list(), opts)
      {opts, [kind], []} when is_map_key(@kinds, kind) -> show(of(@kinds[kind]), opts)
      {_, _, [{switch, _} | _]} -> wrong("unknown option #{switch}")
      {_, [kind | _], _} -> wrong("unknown kind #{inspect(kind)}")
    end
  end

  defp of(kind), do: Enum.filter(Device.list(), &(&1.kind == kind))

  defp wrong(text) do
    IO.puts(:stderr, "situ devices: #{text}\n  Fix: see `situ devices --help`")
    2
  end

  defp show(devices, opts) do
    cond do
      opts[:json] -> IO.puts(Situ.JSON.encode(Enum.map(devices, &json/1)))
      devices == [] -> IO.puts("No devices found. Without hardware: device: \"simulated:FILE\".")
      true -> table(Enum.sort_by(devices, &{&1.kind, not &1.default?, &1.id}), opts)
    end

    0
  end

  defp table(devices, opts) do
    width = devices |> Enum.map(&String.length(&1.id)) |> Enum.max()

    for device <- devices do
      mark = if device.default?, do: "*", else: " "
      kind = device.kind |> Atom.to_string() |> String.pad_trailing(10)
      IO.puts("#{mark} #{String.pad_trailing(device.id, width)}  #{kind}  #{device.name}")
      if opts[:modes], do: Enum.each(device.modes, &IO.puts("    " <> &1))
    end
  end

  defp json(device) do
    %{
      id: device.id,
      kind: device.kind,
      name: device.name,
      default: device.default?,
      modes: device.modes
    }
  end
end
