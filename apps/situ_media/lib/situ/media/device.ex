defmodule Situ.Media.Device do
  @moduledoc """
  Devices behind one behaviour: what can be listed, and how to start capturing from it or playing to it.

  A device is named by a driver and an address, `DRIVER:ADDRESS`:

  | device | driver | kinds |
  |---|---|---|
  | `v4l2:/dev/video0`, `/dev/video0` | `Situ.Media.Device.V4L2` | camera |
  | `pulse:default`, `pulse:virt.monitor` | `Situ.Media.Device.Pulse` | microphone, speaker |
  | `alsa:default`, `alsa:hw:0,0` | `Situ.Media.Device.Alsa` | microphone, speaker |
  | `simulated:talk1.mp4` | `Situ.Media.Device.Simulated` | camera, microphone |
  | `rtsp://...`, `udp://...`, `http://...` | `Situ.Media.Device.Url` | camera, microphone |
  | `lavfi:testsrc`, `x11grab::0` | `Situ.Media.Device.Input` | any input FFmpeg has |

      iex> Situ.Media.Device.parse("/dev/video2")
      {:ok, {Situ.Media.Device.V4L2, "/dev/video2"}}
      iex> Situ.Media.Device.parse("udp://127.0.0.1:5000")
      {:ok, {Situ.Media.Device.Url, "udp://127.0.0.1:5000"}}
      iex> {:error, error} = Situ.Media.Device.parse("puls:default")
      iex> error.fix
      "did you mean \\"pulse\\"? Drivers: alsa, input, lavfi, pulse, simulated, v4l2, x11grab, and any URL"

  Drivers describe; `Situ.Media.Capture` runs what they describe, in a process of the operating system of its own. A new
  kind of device is a module with this behaviour: give `{MyDriver, address}` wherever a device's name is taken.
  """
  alias Situ.Error

  @enforce_keys [:id, :kind]
  defstruct [:id, :kind, :name, default?: false, modes: []]

  @type kind :: :camera | :microphone | :speaker | :depth_camera
  @typedoc "A device that is there: `id` opens it; `modes` are the sizes and rates of a camera, for people."
  @type t :: %__MODULE__{
          id: String.t(),
          kind: kind(),
          name: String.t() | nil,
          default?: boolean(),
          modes: [String.t()]
        }

  @typedoc """
  How to capture: options of `ffmpeg` up to and including its input, and what the times it gives mean:

    * `:wall`: nanoseconds since the epoch, stamped when captured
    * `:arrival`: a clock of the sender's own, set to the pipeline's clock when the first frame arrives
    * `:start`: the pipeline's start is 0

  `ends?` says that the source is meant to end, so that its end is not a loss.
  """
  @type capture :: %{
          required(:args) => [String.t()],
          required(:clock) => :wall | :arrival | :start,
          optional(:ends?) => boolean()
        }
  @type driver :: module()
  @type address :: String.t()
  @type device :: String.t() | {driver(), address()}

  @doc "The devices of this driver that are there now. Empty when its system is not."
  @callback list() :: [t()]

  @doc "How to capture from `address`. `opts` are those of `Situ.Media.Camera` or `Situ.Media.Microphone`."
  @callback capture(address(), kind(), opts :: keyword()) ::
              {:ok, capture()} | {:error, Error.t()}

  @doc "How to play to `address`: the output options of `ffmpeg`."
  @callback playback(address(), opts :: keyword()) :: {:ok, [String.t()]} | {:error, Error.t()}

  @doc "Where to look when a device of this kind cannot be opened."
  @callback help(kind()) :: String.t()

  @optional_callbacks playback: 2, help: 1

  @drivers %{
    "v4l2" => Situ.Media.Device.V4L2,
    "pulse" => Situ.Media.Device.Pulse,
    "alsa" => Situ.Media.Device.Alsa,
    "simulated" => Situ.Media.Device.Simulated
  }
  # Inputs of ffmpeg that are named like drivers.
  @inputs ["lavfi", "x11grab", "input"]

  @doc "The drivers, by name."
  @spec drivers() :: %{String.t() => driver()}
  def drivers, do: @drivers

  @doc "The driver and the address a name means."
  @spec parse(device()) :: {:ok, {driver(), address()}} | {:error, Error.t()}
  def parse({driver, address}) when is_atom(driver) and is_binary(address),
    do: {:ok, {driver, address}}

  def parse("/dev/video" <> _ = path), do: {:ok, {Situ.Media.Device.V4L2, path}}

  def parse(name) when is_binary(name) do
    case String.split(name, ":", parts: 2) do
      [_scheme, "//" <> _] -> {:ok, {Situ.Media.Device.Url, name}}
      [driver, address] when is_map_key(@drivers, driver) -> {:ok, {@drivers[driver], address}}
      [input, _] when input in @inputs -> {:ok, {Situ.Media.Device.Input, name}}
      [other | _] -> {:error, unknown(name, other)}
    end
  end

  @doc "Every device there is, of every driver."
  @spec list() :: [t()]
  def list, do: @drivers |> Map.values() |> Enum.flat_map(& &1.list())

  @doc false
  @spec driver_error(address(), atom(), String.t()) :: {:error, Error.t()}
  def driver_error(address, code, what),
    do: {:error, Error.new(code, "#{address}: #{what}", meta: %{device: address})}

  @doc false
  # The error of a device that does not open, in the words of somebody who wants to use one.
  @spec unopened(Error.t(), driver(), address(), kind()) :: Error.t()
  def unopened(%Error{fix: nil} = error, driver, address, kind) do
    if Code.ensure_loaded?(driver) and function_exported?(driver, :help, 1),
      do: %{error | what: "cannot open the #{kind} #{address}", fix: driver.help(kind)},
      else: error
  end

  def unopened(error, _driver, _address, _kind), do: error

  @doc false
  # Runs a listing program; one that is missing or fails lists nothing.
  @spec run(String.t(), [String.t()]) :: String.t()
  def run(program, args) do
    with path when is_binary(path) <- System.find_executable(program),
         {out, 0} <- System.cmd("timeout", ["5", path | args], stderr_to_stdout: true) do
      out
    else
      _ -> ""
    end
  end

  defp unknown(name, driver) do
    known = Enum.sort(Map.keys(@drivers) ++ @inputs)
    near = Situ.Options.nearest(driver, known)
    hint = if near, do: "did you mean #{inspect(near)}? ", else: ""

    Error.new(
      :unknown_device,
      "there is no driver #{inspect(driver)} for device #{inspect(name)}",
      fix: hint <> "Drivers: " <> Enum.join(known, ", ") <> ", and any URL"
    )
  end
end
