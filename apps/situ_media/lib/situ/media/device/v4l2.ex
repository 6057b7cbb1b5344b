defmodule Situ.Media.Device.V4L2 do
  @moduledoc """
  Cameras of the Linux kernel (Video4Linux): `v4l2:/dev/video0`. Times are stamped by the kernel when the picture was
  taken, as wall time.
  """
  @behaviour Situ.Media.Device
  alias Situ.Media.Device

  @doc """
  The sizes and rates in the listing of `v4l2-ctl --list-formats-ext`.

      iex> Situ.Media.Device.V4L2.modes(\"\"\"
      ...> [0]: 'MJPG' (Motion-JPEG, compressed)
      ...>   Size: Discrete 1280x720
      ...>     Interval: Discrete 0.033s (30.000 fps)
      ...> \"\"\")
      ["MJPG 1280x720 30 fps"]
  """
  @spec modes(String.t()) :: [String.t()]
  def modes(listing) do
    {modes, _} = listing |> String.split("\n") |> Enum.reduce({[], {"?", "?"}}, &line/2)
    Enum.reverse(modes)
  end

  defp line(line, {modes, {format, size} = kept}) do
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

  @impl true
  def list do
    for path <- Enum.sort(Path.wildcard("/sys/class/video4linux/video*")),
        device = "/dev/" <> Path.basename(path),
        # A camera has several nodes; those without pictures (metadata) list no format.
        modes = modes(Device.run("v4l2-ctl", ["-d", device, "--list-formats-ext"])),
        modes != [] or System.find_executable("v4l2-ctl") == nil do
      %Device{id: "v4l2:" <> device, kind: :camera, name: name(path), modes: modes}
    end
    |> mark_default()
  end

  @impl true
  def capture("/dev/" <> _ = path, :camera, opts) do
    size = if opts[:size], do: ["-video_size", join(opts[:size])], else: []
    rate = if opts[:rate], do: ["-framerate", to_string(opts[:rate])], else: []
    input = if opts[:input_format], do: ["-input_format", opts[:input_format]], else: []

    {:ok,
     %{
       args:
         ~w(-f v4l2 -timestamps abs) ++
           size ++ rate ++ input ++ (opts[:args] || []) ++ ["-i", path],
       clock: :wall
     }}
  end

  def capture(address, :camera, _opts),
    do: Device.driver_error(address, :bad_option, "a camera's address is a path like /dev/video0")

  def capture(address, _kind, _opts),
    do: Device.driver_error(address, :bad_option, "a camera gives pictures only")

  defp join({width, height}), do: "#{width}x#{height}"

  defp name(path) do
    case File.read(Path.join(path, "name")) do
      {:ok, name} -> String.trim(name)
      {:error, _} -> nil
    end
  end

  defp mark_default([first | rest]), do: [%{first | default?: true} | rest]
  defp mark_default([]), do: []
end
