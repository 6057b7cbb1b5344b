defmodule Situ.Media.Device do
  @moduledoc """
  Devices: cameras, microphones, speakers and network streams by name, and the behaviour of their drivers.

      for device <- Situ.Media.Device.list(), do: {device.kind, device.id, device.name}
      Situ.Media.Camera.open(p, device: "/dev/video0")
      Situ.Media.Microphone.open(p, device: "simulated:talk1.mp4")

  A device is named by a driver and an address, `DRIVER:ADDRESS`:

  | name | device |
  |---|---|
  | `v4l2:/dev/video0`, `/dev/video0` | a camera of the Linux kernel, which stamps each image with wall time |
  | `pulse:default`, `pulse:virt.monitor` | a microphone or speaker of PulseAudio or PipeWire |
  | `alsa:default`, `alsa:hw:0,0` | a microphone or speaker of the Linux kernel |
  | `simulated:talk1.mp4` | a file as camera and microphone, repeated; with `?once` at the end, it is played once |
  | `rtsp://...`, `udp://...`, `http://...` | a network stream; images and audio keep the sender's time steps |
  | `lavfi:testsrc`, `x11grab::0` | a test image, the screen |
  | `input:NAME` | any other input of FFmpeg, with `args: ["-f", FORMAT]` |

  A simulated camera and a simulated microphone of the same file are synchronized: its media time 0 is the pipeline's
  start. The first frame of a network stream and of FFmpeg's inputs is stamped with the pipeline's time when it arrives.

  ## Your own driver

  A driver only describes devices; Situ captures from them in a separate operating system process. Implement this
  behaviour and pass `{MyDriver, address}` wherever a device name is accepted:

      defmodule Screen do
        @behaviour Situ.Media.Device

        @impl true
        def list, do: []

        @impl true
        def capture(display, :camera, _opts),
          do: {:ok, %{args: ["-f", "x11grab", "-i", display], clock: :arrival}}
      end

      Situ.Media.Camera.open(p, device: {Screen, ":0"})
  """
  # See docs/adr/0050-ffmpeg-runs-in-a-separate-process.md.
  alias Situ.Error

  @enforce_keys [:id, :kind]
  defstruct [:id, :kind, :name, default?: false, modes: []]

  @type kind :: :camera | :microphone | :speaker | :depth_camera
  @typedoc "An available device. `id` opens it, and `modes` lists the sizes and rates of a camera for people."
  @type t :: %__MODULE__{
          id: String.t(),
          kind: kind(),
          name: String.t() | nil,
          default?: boolean(),
          modes: [String.t()]
        }

  @typedoc """
  A description of a capture: the options of `ffmpeg` up to and including its input, and the clock of its times:

    * `:wall`: nanoseconds since the epoch, stamped when captured
    * `:arrival`: the sender's own clock, synchronized with the pipeline's clock when the first frame arrives
    * `:start`: 0 is the pipeline's start

  `ends?` is true if the source is expected to end, so that its end does not count as a loss.
  """
  @type capture :: %{
          required(:args) => [String.t()],
          required(:clock) => :wall | :arrival | :start,
          optional(:ends?) => boolean()
        }
  @type driver :: module()
  @type address :: String.t()
  @type device :: String.t() | {driver(), address()}

  @doc "Lists the devices that are available to this driver, or `[]` if its system is not available."
  @callback list() :: [t()]

  @doc "Describes the capture from `address`. For `opts`, see `Situ.Media.Camera` and `Situ.Media.Microphone`."
  @callback capture(address(), kind(), opts :: keyword()) ::
              {:ok, capture()} | {:error, Error.t()}

  @doc "Returns the output options of `ffmpeg` for playback to `address`."
  @callback playback(address(), opts :: keyword()) :: {:ok, [String.t()]} | {:error, Error.t()}

  @doc "Returns advice for a device of this kind that cannot be opened."
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

  @doc """
  Parses a device name into its driver and address.

      iex> {:ok, {_v4l2, "/dev/video2"}} = Situ.Media.Device.parse_name("/dev/video2")
      iex> {:ok, {_url, "udp://127.0.0.1:5000"}} = Situ.Media.Device.parse_name("udp://127.0.0.1:5000")
      iex> {:error, error} = Situ.Media.Device.parse_name("puls:default")
      iex> error.fix
      "did you mean \\"pulse\\"? Drivers: alsa, input, lavfi, pulse, simulated, v4l2, x11grab, and any URL"
  """
  @spec parse_name(device()) :: {:ok, {driver(), address()}} | {:error, Error.t()}
  def parse_name({driver, address}) when is_atom(driver) and is_binary(address),
    do: {:ok, {driver, address}}

  def parse_name("/dev/video" <> _ = path), do: {:ok, {Situ.Media.Device.V4L2, path}}

  def parse_name(name) when is_binary(name) do
    case String.split(name, ":", parts: 2) do
      [_scheme, "//" <> _] -> {:ok, {Situ.Media.Device.Url, name}}
      [driver, address] when is_map_key(@drivers, driver) -> {:ok, {@drivers[driver], address}}
      [input, _] when input in @inputs -> {:ok, {Situ.Media.Device.Input, name}}
      [other | _] -> {:error, unknown_driver(name, other)}
    end
  end

  @doc "Lists the available devices of all drivers."
  @spec list() :: [t()]
  def list, do: @drivers |> Map.values() |> Enum.flat_map(& &1.list())

  @doc false
  @spec driver_error(address(), atom(), String.t()) :: {:error, Error.t()}
  def driver_error(address, code, what),
    do: {:error, Error.new(code, "#{address}: #{what}", meta: %{device: address})}

  @doc false
  # Rewrites the error of a device that does not open into advice for its user.
  @spec open_error(Error.t(), driver(), address(), kind()) :: Error.t()
  def open_error(%Error{fix: nil} = error, driver, address, kind) do
    if Code.ensure_loaded?(driver) and function_exported?(driver, :help, 1),
      do: %{error | what: "cannot open the #{kind} #{address}", fix: driver.help(kind)},
      else: error
  end

  def open_error(error, _driver, _address, _kind), do: error

  @doc false
  # Runs a program that lists devices. Returns "" if the program is missing or fails.
  @spec run_program(String.t(), [String.t()]) :: String.t()
  def run_program(program, args) do
    with path when is_binary(path) <- System.find_executable(program),
         {out, 0} <- System.cmd("timeout", ["5", path | args], stderr_to_stdout: true) do
      out
    else
      _ -> ""
    end
  end

  defp unknown_driver(name, driver) do
    known = Enum.sort(Map.keys(@drivers) ++ @inputs)
    near = Situ.Options.nearest_name(driver, known)
    hint = if near, do: "did you mean #{inspect(near)}? ", else: ""

    Error.new(
      :unknown_device,
      "unknown driver #{inspect(driver)} for device #{inspect(name)}",
      fix: hint <> "Drivers: " <> Enum.join(known, ", ") <> ", and any URL"
    )
  end
end
