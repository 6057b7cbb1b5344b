defmodule Situ.CLI.Devices do
  @moduledoc false
  # `situ devices`: lists the cameras, microphones, speakers and depth cameras of this machine.
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Option, Output, Verb}
  alias Situ.Media.Device
  alias Situ.Space.DepthCamera

  @kinds %{
    "cameras" => :camera,
    "microphones" => :microphone,
    "speakers" => :speaker,
    "depth" => :depth_camera
  }

  @impl true
  def verbs do
    [
      %Verb{
        words: ["devices"],
        summary: "list cameras, microphones, speakers and depth cameras",
        about: """
        Lists the devices that Situ.Media.Camera, Microphone and Speaker can open on this machine: V4L2 cameras, and
        the audio devices of PulseAudio (PipeWire) and ALSA. The first column is the value for the option `device:`;
        * marks the default. Without any hardware, "simulated:FILE" replays a file as a camera and a microphone. Depth
        cameras of OpenNI 2 and libfreenect, for Situ.Space.DepthCamera.Library, are listed after
        `bin/setup --with depth`.
        """,
        arguments: [
          kind: [
            kind: :text,
            optional: true,
            doc: "cameras, microphones, speakers or depth (default: all)"
          ]
        ],
        options: [Option.new(:modes, :flag, "also list the sizes and rates of each camera")],
        examples: ["situ devices cameras --modes"],
        run: &run_devices/2
      }
    ]
  end

  defp run_devices(%{kind: nil}, opts), do: show_devices(list_all(), opts)

  defp run_devices(%{kind: kind}, opts) when is_map_key(@kinds, kind),
    do: show_devices(list_of_kind(@kinds[kind]), opts)

  defp run_devices(%{kind: kind}, _opts),
    do:
      throw(
        {:usage,
         "devices: unknown kind #{inspect(kind)}; use cameras, microphones, speakers or depth"}
      )

  defp list_of_kind(:depth_camera), do: DepthCamera.Library.list_cameras()
  defp list_of_kind(kind), do: Enum.filter(Device.list(), &(&1.kind == kind))

  defp list_all, do: Device.list() ++ DepthCamera.Library.list_cameras()

  defp show_devices(devices, opts) do
    cond do
      opts[:json] ->
        Output.print_json(Enum.map(devices, &device_json/1))

      devices == [] ->
        Output.puts("No devices found. Without hardware: device: \"simulated:FILE\".")

      true ->
        print_table(Enum.sort_by(devices, &{&1.kind, not &1.default?, &1.id}), opts)
    end

    0
  end

  defp print_table(devices, opts) do
    width = devices |> Enum.map(&String.length(&1.id)) |> Enum.max()

    for device <- devices do
      mark = if device.default?, do: "*", else: " "

      kind =
        device.kind |> Atom.to_string() |> String.replace("_", " ") |> String.pad_trailing(12)

      Output.puts("#{mark} #{String.pad_trailing(device.id, width)}  #{kind}  #{device.name}")
      if opts[:modes], do: Enum.each(device.modes, &Output.puts("    " <> &1))
    end
  end

  defp device_json(device) do
    %{
      id: device.id,
      kind: device.kind,
      name: device.name,
      default: device.default?,
      modes: device.modes
    }
  end
end
