defmodule Situ.Space.DepthCamera.Library.PortProgram do
  @moduledoc false
  # Finds and starts the program depth_port, and decodes its packets (see ports/depth_port/main.cc).
  alias Situ.{CameraIntrinsics, Error}

  # Two images of each kind are requested in advance, so that one is being captured while the other is processed.
  @asked 2
  @kinds [depth: 1, color: 2]
  @kind_of Map.new(@kinds, fn {kind, byte} -> {byte, kind} end)

  @type packet ::
          {:camera, String.t(), %{depth: lens(), color: lens()}}
          | {:picture, :depth | :color, Situ.Time.t(), lost :: non_neg_integer(), size(),
             binary()}
          | {:failed, String.t()}
          | :over
  @type lens :: CameraIntrinsics.t() | size() | nil
  @type size :: {pos_integer(), pos_integer()}

  @doc "Returns the arguments and the environment for a device."
  @spec device_arguments(String.t()) ::
          {:ok, {[String.t()], [{String.t(), String.t()}]}} | {:error, Error.t()}
  def device_arguments(device) do
    case String.split(device, ":", parts: 2) do
      ["openni2", uri] -> {:ok, {["openni2", uri], []}}
      ["freenect", ""] -> {:ok, {["freenect"], []}}
      ["freenect", index] -> freenect_arguments(Integer.parse(index), device)
      ["fakenect", folder] -> fakenect_arguments(folder)
      _ -> {:error, bad_device(device)}
    end
  end

  defp freenect_arguments({index, ""}, _device) when index >= 0,
    do: {:ok, {["freenect", "#{index}"], []}}

  defp freenect_arguments(_other, device), do: {:error, bad_device(device)}

  defp bad_device(device) do
    Error.new(:bad_device, "#{inspect(device)} is not a depth camera",
      why: "valid addresses are \"openni2:URI\", \"freenect:INDEX\" and \"fakenect:FOLDER\"",
      fix: "`situ devices` lists the connected cameras"
    )
  end

  # libfreenect's playback library has the same file name as the real one. LD_LIBRARY_PATH makes it take precedence.
  defp fakenect_arguments(folder) do
    with true <- File.regular?(Path.join(folder, "INDEX.txt")),
         [library | _] <- Path.wildcard("/usr/lib/*/fakenect") do
      {:ok, {["freenect"], [{"FAKENECT_PATH", folder}, {"LD_LIBRARY_PATH", library}]}}
    else
      false ->
        {:error,
         Error.new(:no_camera, "#{folder} is not a Kinect recording",
           why: "it has no INDEX.txt, which fakenect-record writes"
         )}

      [] ->
        {:error,
         Error.new(:no_camera, "libfreenect's library fakenect is not installed",
           fix: "run bin/setup --with depth"
         )}
    end
  end

  @doc "Starts the program. The calling process receives its packets."
  @spec open(String.t()) :: {:ok, port()} | {:error, Error.t()}
  def open(device) do
    with {:ok, program} <- fetch_path(), {:ok, {words, env}} <- device_arguments(device) do
      env = for {name, value} <- env, do: {to_charlist(name), to_charlist(value)}

      {:ok,
       Port.open({:spawn_executable, program}, [
         :binary,
         :exit_status,
         packet: 4,
         args: words,
         env: env
       ])}
    end
  end

  @doc "Requests the first images, or one more image of a kind."
  @spec request_images(port(), :depth | :color | :first) :: true
  def request_images(port, :first),
    do: send_command(port, for({_kind, byte} <- @kinds, _ <- 1..@asked, do: byte))

  def request_images(port, kind), do: send_command(port, [Keyword.fetch!(@kinds, kind)])

  # The program may have exited already, while its last messages are still in flight.
  defp send_command(port, bytes) do
    Port.command(port, bytes)
  rescue
    ArgumentError -> true
  end

  @doc "Ends the program."
  @spec close(port()) :: :ok
  def close(port) do
    Port.close(port)
    :ok
  rescue
    ArgumentError -> :ok
  end

  @doc "Returns one line for each camera."
  @spec list_cameras() :: [String.t()]
  def list_cameras do
    with {:ok, program} <- fetch_path(),
         {lines, 0} <- System.cmd(program, ["list"], stderr_to_stdout: false) do
      String.split(lines, "\n", trim: true)
    else
      _ -> []
    end
  end

  @doc "Returns the path of the program."
  @spec fetch_path() :: {:ok, Path.t()} | {:error, Error.t()}
  def fetch_path do
    path =
      System.get_env("SITU_DEPTH_PORT") ||
        Path.join([:code.priv_dir(:situ_space), "depth", "depth_port"])

    if File.regular?(path) do
      {:ok, path}
    else
      {:error,
       Error.new(:no_depth_port, "this camera needs the program depth_port",
         why: "#{path} does not exist",
         fix:
           "run bin/setup --with depth (installs small Debian packages), or set SITU_DEPTH_PORT to its path"
       )}
    end
  end

  @doc "Decodes a packet of the program; returns `:error` for invalid packets."
  @spec decode_packet(binary()) :: packet() | :error
  def decode_packet(<<0, depth::binary-size(24), color::binary-size(24), name::binary>>),
    do: {:camera, clean_text(name), %{depth: decode_lens(depth), color: decode_lens(color)}}

  def decode_packet(
        <<kind, time::little-signed-64, lost::little-32, w::little-32, h::little-32,
          pixels::binary>>
      )
      when is_map_key(@kind_of, kind) and
             ((kind == 1 and byte_size(pixels) == w * h * 2) or
                (kind == 2 and byte_size(pixels) == w * h * 3)),
      do: {:picture, @kind_of[kind], time, lost, {w, h}, pixels}

  def decode_packet(<<3, why::binary>>), do: {:failed, clean_text(why)}
  def decode_packet(<<4>>), do: :over
  def decode_packet(_other), do: :error

  defp decode_lens(<<0::32, _::binary>>), do: nil

  defp decode_lens(<<w::little-32, h::little-32, x::little-float-64, y::little-float-64>>)
       when x > 0 and y > 0,
       do: CameraIntrinsics.new!(width: w, height: h, focal: {x, y})

  defp decode_lens(<<w::little-32, h::little-32, _::binary>>), do: {w, h}

  defp clean_text(bytes) do
    words = if String.valid?(bytes), do: bytes, else: inspect(bytes)
    words |> String.trim() |> String.slice(0, 300)
  end
end
