defmodule Situ.Media.FFmpeg.Socket do
  @moduledoc false
  # A local (Unix) socket for one ffmpeg. It listens in a folder that only this user can enter, accepts one connection,
  # and removes the folder.
  #
  # Measured for raw images of 1920x1080, which arrive in about 120 segments: native `recv` with
  # `MSG_WAITALL` costs as much as this socket (0.9 ms user, 2.5 ms system), and a pipe costs more
  # (3.3 instead of 2.7 ms). Sending YUV would save about 30 %, but the conversion would then need
  # the color matrix and range of each image, which NUT does not contain.

  defstruct [:listen, :folder, :path]

  @type t :: %__MODULE__{listen: :gen_tcp.socket(), folder: Path.t(), path: Path.t()}

  # The address of a local socket is limited to 107 bytes: "/situ-media-", a random name of 20 bytes, and "/s" take 34.
  @longest_parent 107 - 34

  @spec open_listener(keyword()) :: {:ok, t()} | {:error, Situ.Error.t()}
  def open_listener(opts \\ []) do
    parent = System.tmp_dir() || "/tmp"
    parent = if byte_size(parent) > @longest_parent, do: "/tmp", else: parent

    with {:ok, folder} <- Situ.TempFolder.create_folder("media", parent),
         path = Path.join(folder, "s"),
         settings = [:binary, active: false, ifaddr: {:local, path}, backlog: 1] ++ opts,
         {:ok, listen} <- :gen_tcp.listen(0, settings) do
      {:ok, %__MODULE__{listen: listen, folder: folder, path: path}}
    else
      {:error, %Situ.Error{} = error} ->
        {:error, error}

      {:error, reason} ->
        {:error,
         Situ.Error.new(:no_socket, "cannot create a local socket: #{inspect(reason)}",
           fix: "set TMPDIR to a writable folder with a short path"
         )}
    end
  end

  @doc "Returns the address in ffmpeg's syntax."
  @spec ffmpeg_url(t()) :: String.t()
  def ffmpeg_url(%__MODULE__{path: path}), do: "unix:" <> path

  @doc """
  Waits until ffmpeg connects, exits (`{:error, {:exit, status}}`), or `timeout` ms have passed. Calls `drain`
  repeatedly to receive the program's messages.
  """
  @spec accept_ffmpeg(t(), port(), timeout(), state, (state -> state)) ::
          {{:ok, :gen_tcp.socket()} | {:error, term()}, state}
        when state: term()
  def accept_ffmpeg(%__MODULE__{} = socket, port, timeout, state, drain) do
    deadline =
      if timeout == :infinity,
        do: :infinity,
        else: System.monotonic_time(:millisecond) + timeout

    try do
      poll_accept(socket, port, deadline, state, drain)
    after
      close_listener(socket)
    end
  end

  defp poll_accept(socket, port, deadline, state, drain) do
    state = drain.(state)

    receive do
      {^port, {:exit_status, status}} -> {{:error, {:exit, status}}, drain.(state)}
    after
      0 ->
        case :gen_tcp.accept(socket.listen, 20) do
          {:error, :timeout} ->
            if deadline != :infinity and System.monotonic_time(:millisecond) > deadline,
              do: {{:error, :timeout}, state},
              else: poll_accept(socket, port, deadline, state, drain)

          result ->
            {result, state}
        end
    end
  end

  @doc "Stops listening and removes the socket's folder."
  @spec close_listener(t()) :: :ok
  def close_listener(%__MODULE__{} = socket) do
    :gen_tcp.close(socket.listen)
    _ = File.rm(socket.path)
    _ = File.rmdir(socket.folder)
    :ok
  end
end
