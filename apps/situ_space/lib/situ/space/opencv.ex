defmodule Situ.Space.OpenCV do
  @moduledoc """
  The program `opencv_port` beside: OpenCV's `calib3d` for chessboards (`Situ.Space.Chessboard`) and stereo
  (`Situ.Space.Stereo`). `bin/setup --with opencv` builds it; nothing else needs it, and what goes wrong in it harms no
  one else.

      {:ok, session} = Situ.Space.OpenCV.open()
      {:ok, corners} = Situ.Space.Chessboard.corners(picture, {9, 6}, session: session)
      Situ.Space.OpenCV.close(session)

  A session belongs to the process that opened it and ends with it. Functions without one open their own for that call,
  which takes some 50 ms.
  """
  alias Situ.Error

  @enforce_keys [:port, :timeout]
  defstruct @enforce_keys
  @opaque t :: %__MODULE__{port: port(), timeout: timeout()}

  @timeout 60_000

  @doc "Where the program is. Error: `:no_opencv_port`."
  @spec program() :: {:ok, Path.t()} | {:error, Error.t()}
  def program do
    path =
      System.get_env("SITU_OPENCV_PORT") ||
        Path.join([:code.priv_dir(:situ_space), "opencv", "opencv_port"])

    if File.regular?(path) do
      {:ok, path}
    else
      {:error,
       Error.new(:no_opencv_port, "chessboards and stereo need the program opencv_port",
         why: "#{path} is not there",
         fix: "run bin/setup --with opencv (3 MB), or set SITU_OPENCV_PORT to it"
       )}
    end
  end

  @doc "Starts it for the calling process. `timeout:` how long an answer may take, ms (a minute by default)."
  @spec open(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(opts \\ []) do
    with {:ok, program} <- program() do
      port = Port.open({:spawn_executable, program}, [:binary, :exit_status, packet: 4])
      {:ok, %__MODULE__{port: port, timeout: opts[:timeout] || @timeout}}
    end
  end

  @doc "Ends it."
  @spec close(t()) :: :ok
  def close(%__MODULE__{port: port}) do
    if Port.info(port), do: Port.close(port)
    flush(port)
  end

  defp flush(port) do
    receive do
      {^port, _} -> flush(port)
    after
      0 -> :ok
    end
  end

  @doc false
  @spec call(t() | nil, iodata()) :: {:ok, binary()} | :not_found | {:error, Error.t()}
  def call(nil, request) do
    with {:ok, session} <- open() do
      result = call(session, request)
      close(session)
      result
    end
  end

  def call(%__MODULE__{port: port} = session, request) do
    Port.command(port, request)

    receive do
      {^port, {:data, <<0, result::binary>>}} -> {:ok, result}
      {^port, {:data, <<1>>}} -> :not_found
      {^port, {:data, <<2, why::binary>>}} -> {:error, refused(String.trim(why))}
      {^port, {:exit_status, status}} -> {:error, ended("it ended with status #{status}")}
    after
      session.timeout ->
        close(session)
        {:error, ended("it gave no answer in #{session.timeout} ms")}
    end
  rescue
    ArgumentError -> {:error, ended("the session has ended, or is another process's")}
  end

  defp refused(why),
    do: Error.new(:opencv_failed, "OpenCV refuses this", why: String.slice(why, 0, 300))

  defp ended(why),
    do:
      Error.new(:opencv_ended, "opencv_port gave no result", why: why, fix: "open a new session")
end
