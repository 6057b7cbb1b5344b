defmodule Situ.Space.OpenCV do
  @moduledoc """
  The program `opencv_port` beside: OpenCV's `calib3d` for chessboards (`Situ.Space.Chessboard`) and stereo
  (`Situ.Space.Stereo`). `bin/setup --with opencv` builds it; nothing else needs it, and what goes wrong in it harms no
  one else.

      {:ok, session} = Situ.Space.OpenCV.open()
      {:ok, corners} = Situ.Space.Chessboard.corners(picture, {9, 6}, session: session)
      Situ.Space.OpenCV.close(session)

  A session ends with the process that opened it. Functions without one open their own for that call, which takes some
  50 ms.
  """
  # A process of its own has the program: a pipe that breaks ends who holds it.
  use GenServer, restart: :temporary
  alias Situ.Error

  @enforce_keys [:server, :timeout]
  defstruct @enforce_keys
  @type t :: %__MODULE__{server: pid(), timeout: timeout()}

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
      {:ok, server} = GenServer.start(__MODULE__, {program, self()})
      {:ok, %__MODULE__{server: server, timeout: opts[:timeout] || @timeout}}
    end
  end

  @doc "Ends it."
  @spec close(t()) :: :ok
  def close(%__MODULE__{server: server}) do
    GenServer.stop(server, :normal, 10_000)
  catch
    :exit, _ -> :ok
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

  def call(%__MODULE__{} = session, request) do
    GenServer.call(session.server, {:call, request, session.timeout}, :infinity)
  catch
    :exit, _ -> {:error, ended("the session has ended")}
  end

  @impl true
  def init({program, owner}) do
    Process.flag(:trap_exit, true)
    Process.monitor(owner)
    {:ok, Port.open({:spawn_executable, program}, [:binary, :exit_status, packet: 4])}
  end

  @impl true
  def handle_call({:call, request, timeout}, _from, port) do
    send(port, {self(), {:command, request}})

    receive do
      {^port, {:data, <<0, result::binary>>}} -> {:reply, {:ok, result}, port}
      {^port, {:data, <<1>>}} -> {:reply, :not_found, port}
      {^port, {:data, <<2, why::binary>>}} -> {:reply, {:error, refused(String.trim(why))}, port}
      {^port, {:exit_status, status}} -> stop("it ended with status #{status}", port)
      {:EXIT, ^port, reason} -> stop("it ended: #{inspect(reason)}", port)
    after
      timeout -> stop("it gave no answer in #{timeout} ms", port)
    end
  end

  # Of another picture the rest may come: the session cannot go on.
  defp stop(why, port), do: {:stop, :normal, {:error, ended(why)}, port}

  @impl true
  def handle_info(_ended, port), do: {:stop, :normal, port}

  defp refused(why),
    do: Error.new(:opencv_failed, "OpenCV refuses this", why: String.slice(why, 0, 300))

  defp ended(why),
    do:
      Error.new(:opencv_ended, "opencv_port gave no result", why: why, fix: "open a new session")
end
