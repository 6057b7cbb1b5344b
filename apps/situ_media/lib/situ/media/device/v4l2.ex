defmodule Situ.Media.Device.V4L2 do
  @moduledoc false
  # Cameras of the Linux kernel (Video4Linux): `v4l2:/dev/video0`. The kernel stamps each image
  # with the wall time at which it was taken.
  @behaviour Situ.Media.Device
  alias Situ.Media.Device

  @impl true
  def help(kind) do
    "list the available devices with `situ devices #{kind}s`; if the camera is listed, add your user to the group " <>
      "video, or close the other program that uses it"
  end

  @doc """
  Parses sizes and rates from the output of `v4l2-ctl --list-formats-ext`.

      iex> Situ.Media.Device.V4L2.parse_modes(\"\"\"
      ...> [0]: 'MJPG' (Motion-JPEG, compressed)
      ...>   Size: Discrete 1280x720
      ...>     Interval: Discrete 0.033s (30.000 fps)
      ...> \"\"\")
      ["MJPG 1280x720 30 fps"]
  """
  @spec parse_modes(String.t()) :: [String.t()]
  def parse_modes(listing) do
    {modes, _} = listing |> String.split("\n") |> Enum.reduce({[], {"?", "?"}}, &parse_line/2)
    Enum.reverse(modes)
  end

  defp parse_line(line, {modes, {format, size} = kept}) do
    cond do
      match = Regex.run(~r/\[\d+\]: '(.{4})'/, line) ->
        {modes, {Enum.at(match, 1), size}}

      match = Regex.run(~r/Size: \w+ (\d+x\d+)/, line) ->
        {modes, {format, Enum.at(match, 1)}}

      match = Regex.run(~r/\((\d+)\.\d+ fps\)/, line) ->
        {["#{format} #{size} #{Enum.at(match, 1)} fps" | modes], kept}

      true ->
        {modes, kept}
    end
  end

  @typedoc """
  `min`, `max`, `step` and `default` are `nil` if the device does not report them. The `value` of a menu control is
  the number of the selected row.
  """
  @type control :: %{
          name: String.t(),
          type: String.t(),
          min: integer() | nil,
          max: integer() | nil,
          step: integer() | nil,
          default: integer() | nil,
          value: integer() | nil
        }

  @doc "Lists the controls of the camera at `path`, or `[]` without a camera or without `v4l2-ctl`."
  @spec list_controls(Path.t()) :: [control()]
  def list_controls(path),
    do: parse_controls(Device.run_program("v4l2-ctl", ["-d", path, "--list-ctrls"]))

  @doc """
  Parses the output of `v4l2-ctl --list-ctrls`.

      iex> Situ.Media.Device.V4L2.parse_controls(\"\"\"
      ...> User Controls
      ...>
      ...>                      brightness 0x00980900 (int)    : min=-64 max=64 step=1 default=0 value=-12
      ...>         white_balance_automatic 0x0098090c (bool)   : default=1 value=1
      ...> \"\"\")
      [
        %{name: "brightness", type: "int", min: -64, max: 64, step: 1, default: 0, value: -12},
        %{name: "white_balance_automatic", type: "bool", min: nil, max: nil, step: nil, default: 1, value: 1}
      ]
  """
  @spec parse_controls(String.t()) :: [control()]
  def parse_controls(listing) do
    for [_, name, type, fields] <-
          Regex.scan(~r/^\s*(\w+) 0x[0-9a-f]+ \((\w+)\)\s*:(.*)$/m, listing) do
      numbers =
        for [_, key, value] <- Regex.scan(~r/(\w+)=(-?\d+)/, fields),
            into: %{},
            do: {key, String.to_integer(value)}

      %{
        name: name,
        type: type,
        min: numbers["min"],
        max: numbers["max"],
        step: numbers["step"],
        default: numbers["default"],
        value: numbers["value"]
      }
    end
  end

  # Controls are set before the camera is opened, so that an unknown control is reported as an error.
  defp set_controls(_path, []), do: :ok

  defp set_controls(path, controls) do
    settings = Enum.map_join(controls, ",", fn {name, value} -> "#{name}=#{value}" end)

    with program when is_binary(program) <- System.find_executable("v4l2-ctl"),
         {_, 0} <-
           System.cmd("timeout", ["5", program, "-d", path, "--set-ctrl", settings],
             stderr_to_stdout: true
           ) do
      :ok
    else
      nil ->
        Device.driver_error(
          path,
          :no_v4l2_ctl,
          "setting controls needs v4l2-ctl: apt-get install v4l-utils"
        )

      {why, _} ->
        Device.driver_error(path, :bad_option, "cannot set #{settings}: #{String.trim(why)}")
    end
  end

  @impl true
  def list do
    for path <- Enum.sort(Path.wildcard("/sys/class/video4linux/video*")),
        device = "/dev/" <> Path.basename(path),
        # A camera has several nodes; nodes without images (metadata) list no format.
        modes = parse_modes(Device.run_program("v4l2-ctl", ["-d", device, "--list-formats-ext"])),
        modes != [] or System.find_executable("v4l2-ctl") == nil do
      %Device{id: "v4l2:" <> device, kind: :camera, name: read_name(path), modes: modes}
    end
    |> mark_default()
  end

  @impl true
  def capture("/dev/" <> _ = path, :camera, opts) do
    size = if opts[:size], do: ["-video_size", format_size(opts[:size])], else: []
    rate = if opts[:rate], do: ["-framerate", to_string(opts[:rate])], else: []
    input = if opts[:input_format], do: ["-input_format", opts[:input_format]], else: []

    with :ok <- set_controls(path, opts[:controls] || []) do
      {:ok,
       %{
         args:
           ~w(-f v4l2 -timestamps abs) ++
             size ++ rate ++ input ++ (opts[:args] || []) ++ ["-i", path],
         clock: :wall
       }}
    end
  end

  def capture(address, :camera, _opts),
    do:
      Device.driver_error(
        address,
        :bad_option,
        "the address of a camera must be a path like /dev/video0"
      )

  def capture(address, _kind, _opts),
    do: Device.driver_error(address, :bad_option, "a camera provides images only")

  defp format_size({width, height}), do: "#{width}x#{height}"

  defp read_name(path) do
    case File.read(Path.join(path, "name")) do
      {:ok, name} -> String.trim(name)
      {:error, _} -> nil
    end
  end

  defp mark_default([first | rest]), do: [%{first | default?: true} | rest]
  defp mark_default([]), do: []
end
