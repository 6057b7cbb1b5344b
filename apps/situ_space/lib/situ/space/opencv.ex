defmodule Situ.Space.OpenCV do
  @moduledoc """
  A running OpenCV program that several calls of `Situ.Space.Chessboard` share.

      {:ok, session} = Situ.Space.OpenCV.open()
      {:ok, corners} = Situ.Space.Chessboard.corners(picture, {9, 6}, session: session)
      Situ.Space.OpenCV.close(session)

  OpenCV's `calib3d` runs in the separate program `opencv_port`, so a crash affects only its session. `bin/setup
  --with opencv` builds the program, and only chessboards and `Situ.Space.StereoDepth` need it. A session ends with
  the process that opened it. Functions called without a session open one for that call, which takes about 50 ms.
  """
  # See docs/adr/0105-large-libraries-run-in-separate-programs.md.

  # A separate process owns the program, because a broken pipe would end the owner.
  use GenServer, restart: :temporary
  alias Situ.Error

  @enforce_keys [:server, :timeout]
  defstruct @enforce_keys
  @type t :: %__MODULE__{server: pid(), timeout: timeout()}

  @timeout 60_000

  @doc false
  # Returns the path of the program.
  @spec fetch_program() :: {:ok, Path.t()} | {:error, Error.t()}
  def fetch_program do
    path =
      System.get_env("SITU_OPENCV_PORT") ||
        Path.join([:code.priv_dir(:situ_space), "opencv", "opencv_port"])

    if File.regular?(path) do
      {:ok, path}
    else
      {:error,
       Error.new(:no_opencv_port, "chessboards and stereo need the program opencv_port",
         why: "#{path} does not exist",
         fix: "run bin/setup --with opencv (3 MB), or set SITU_OPENCV_PORT to its path"
       )}
    end
  end

  @doc """
  Starts the program for the calling process. `timeout:` limits the time of a request, ms (default: one minute). Error:
  `:no_opencv_port`.
  """
  @spec open(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(opts \\ []) do
    with {:ok, program} <- fetch_program() do
      {:ok, server} = GenServer.start(__MODULE__, {program, self()})
      {:ok, %__MODULE__{server: server, timeout: opts[:timeout] || @timeout}}
    end
  end

  @doc "Ends the session and its program."
  @spec close(t()) :: :ok
  def close(%__MODULE__{server: server}) do
    GenServer.stop(server, :normal, 10_000)
  catch
    :exit, _ -> :ok
  end

  @doc false
  @spec call_program(t() | nil, iodata()) :: {:ok, binary()} | :not_found | {:error, Error.t()}
  def call_program(nil, request) do
    with {:ok, session} <- open() do
      result = call_program(session, request)
      close(session)
      result
    end
  end

  def call_program(%__MODULE__{} = session, request) do
    GenServer.call(session.server, {:call, request, session.timeout}, :infinity)
  catch
    :exit, _ -> {:error, ended_error("the session has ended")}
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
      {^port, {:data, <<0, result::binary>>}} ->
        {:reply, {:ok, result}, port}

      {^port, {:data, <<1>>}} ->
        {:reply, :not_found, port}

      {^port, {:data, <<2, why::binary>>}} ->
        {:reply, {:error, refusal_error(String.trim(why))}, port}

      {^port, {:exit_status, status}} ->
        stop_session("it ended with status #{status}", port)

      {:EXIT, ^port, reason} ->
        stop_session("it ended: #{inspect(reason)}", port)
    after
      timeout -> stop_session("it did not respond within #{timeout} ms", port)
    end
  end

  # A late result could be taken for the next one, so the session cannot continue.
  defp stop_session(why, port), do: {:stop, :normal, {:error, ended_error(why)}, port}

  @impl true
  def handle_info(_ended, port), do: {:stop, :normal, port}

  defp refusal_error(why),
    do: Error.new(:opencv_failed, "OpenCV rejected the request", why: String.slice(why, 0, 300))

  defp ended_error(why),
    do:
      Error.new(:opencv_ended, "opencv_port returned no result",
        why: why,
        fix: "open a new session"
      )
end
