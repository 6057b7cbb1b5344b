defmodule Situ.Media.FFmpeg.Writer do
  @moduledoc false
  # A process that runs one `ffmpeg` and feeds it raw frames, for encoders and speakers.
  #
  # `write_frame/4` waits while `ffmpeg` is busy (about one image is in flight), so a slow encoder
  # slows its pipeline down. If the writer ends without `finish_output/2`, `ffmpeg` still sees the
  # end of its input and finishes the file.
  use GenServer, restart: :temporary, shutdown: 1_000

  alias Situ.Error
  alias Situ.Media.FFmpeg
  alias Situ.Media.FFmpeg.{Log, Socket}
  alias Situ.Media.Nut.Muxer

  @schema [
    streams: [type: {:list, :map}, required: true, doc: "See `Situ.Media.Nut.Muxer`."],
    args: [type: {:list, :string}, required: true, doc: "Output options, and the output."],
    input_args: [type: {:list, :string}, default: [], doc: "Further input options."],
    name: [type: :string, required: true, doc: "Name of the output, for errors."],
    buffer: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Maximum bytes that wait in the socket; use a small value for low latency."
    ],
    bound: [
      type: :boolean,
      default: false,
      doc: "Kill `ffmpeg` when the writer ends (devices), instead of letting it finish (files)."
    ],
    connect_timeout: [type: :pos_integer, default: 30_000, doc: "Maximum time to start, ms."]
  ]

  defstruct [:port, :socket, :name, :failed, :status, log: %Log{}]

  @doc """
  Starts `ffmpeg` and the process that feeds it. The process is linked to the caller.

  #{Situ.Options.docs(@schema)}
  """
  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, program} <- FFmpeg.fetch_executable("ffmpeg") do
      GenServer.start_link(__MODULE__, {program, opts})
    end
  end

  @doc """
  Writes one frame of stream `id` at `time` ns (0 or more), and waits while `ffmpeg` is busy. A packet of a compressed
  stream is given as `{bytes, key?}`.
  """
  @spec write_frame(
          pid(),
          non_neg_integer(),
          non_neg_integer(),
          binary() | {binary(), boolean()},
          timeout()
        ) :: :ok | {:error, Error.t()}
  def write_frame(writer, id, time, frame, timeout \\ :infinity) do
    {data, key?} = if is_binary(frame), do: {frame, true}, else: frame
    GenServer.call(writer, {:write, Muxer.encode_frame(id, time, data, key?)}, timeout)
  end

  @doc "Returns the error of an `ffmpeg` that has ended."
  @spec check_running(pid()) :: :ok | {:error, Error.t()}
  def check_running(writer), do: GenServer.call(writer, :check, :infinity)

  @doc "Ends the input, so that `ffmpeg` writes what remains."
  @spec end_input(pid()) :: :ok | {:error, Error.t()}
  def end_input(writer), do: GenServer.call(writer, :end_input, :infinity)

  @doc "Waits until `ffmpeg`, whose output has ended, has ended too."
  @spec await_end(pid()) :: :ok | {:error, Error.t()}
  def await_end(writer), do: GenServer.call(writer, :await_end, :infinity)

  @doc "Ends the input, waits until `ffmpeg` has finished the output, and stops the writer."
  @spec finish_output(pid(), timeout()) :: :ok | {:error, Error.t()}
  def finish_output(writer, timeout \\ 120_000) do
    result = GenServer.call(writer, {:finish, timeout}, :infinity)
    GenServer.stop(writer)
    result
  end

  @impl true
  def init({program, opts}),
    do: {:ok, %__MODULE__{name: opts[:name]}, {:continue, {program, opts}}}

  @impl true
  def handle_continue({program, opts}, state) do
    buffer =
      if opts[:buffer], do: [sndbuf: opts[:buffer], high_watermark: 1, low_watermark: 0], else: []

    case Socket.open_listener(buffer) do
      {:ok, socket} -> {:noreply, connect_ffmpeg(state, socket, program, opts)}
      {:error, error} -> {:noreply, %{state | failed: error}}
    end
  end

  @impl true
  def handle_call(:await_end, _from, %{status: 0} = state), do: {:reply, :ok, state}

  def handle_call(_request, _from, %{failed: %Error{} = error} = state),
    do: {:reply, {:error, error}, state}

  def handle_call({:write, frame}, _from, state) do
    case :gen_tcp.send(state.socket, frame) do
      :ok ->
        {:reply, :ok, %{state | log: Log.take_lines(state.log, state.port)}}

      {:error, _closed} ->
        {status, state} = exit_status(state, 2_000)
        state = mark_failed(state, status)
        {:reply, {:error, state.failed}, state}
    end
  end

  def handle_call(:check, _from, state), do: {:reply, :ok, state}

  def handle_call(:end_input, _from, state) do
    _ = :gen_tcp.shutdown(state.socket, :write)
    {:reply, :ok, state}
  end

  def handle_call(:await_end, _from, state), do: {:reply, finish_program(state), state}

  def handle_call({:finish, timeout}, _from, state) do
    # This flushes unsent frames before the socket closes.
    :ok = :gen_tcp.shutdown(state.socket, :write)
    {:reply, finish_program(state, timeout), state}
  end

  @impl true
  def handle_info({port, {:data, {_eol, line}}}, %{port: port} = state),
    do: {:noreply, %{state | log: Log.add_line(state.log, line)}}

  def handle_info({port, {:exit_status, status}}, %{port: port} = state),
    do: {:noreply, mark_failed(%{state | status: status}, status)}

  defp connect_ffmpeg(state, socket, program, opts) do
    # The header describes the input completely, so ffmpeg does not have to probe it, which would cause a delay.
    input = ~w(-copyts -probesize 32 -analyzeduration 0 -fpsprobesize 0 -f nut -i)

    args =
      FFmpeg.global_options() ++
        opts[:input_args] ++ input ++ [Socket.ffmpeg_url(socket) | opts[:args]]

    port = FFmpeg.start_program(program, args, bound: opts[:bound])
    drain = fn log -> Log.take_lines(log, port) end
    {result, log} = Socket.accept_ffmpeg(socket, port, opts[:connect_timeout], %Log{}, drain)
    state = %{state | port: port, log: log}

    with {:ok, accepted} <- result,
         :ok <- :gen_tcp.send(accepted, Muxer.encode_header(opts[:streams])) do
      %{state | socket: accepted}
    else
      {:error, reason} -> mark_failed(state, reason)
    end
  end

  defp finish_program(state, timeout \\ 5_000) do
    case exit_status(state, timeout) do
      {0, _state} -> :ok
      {status, state} -> {:error, write_error(state, status)}
    end
  end

  defp mark_failed(state, status), do: %{state | failed: write_error(state, status)}

  defp write_error(state, :timeout),
    do: Log.to_error(state.log, :media_timeout, "writing #{state.name} timed out")

  defp write_error(state, status),
    do:
      Log.to_error(state.log, :cannot_write, "cannot write #{state.name}", meta: [status: status])

  defp exit_status(%{port: port} = state, timeout) do
    receive do
      {^port, {:exit_status, status}} ->
        {status, %{state | log: Log.take_lines(state.log, port)}}

      {^port, {:data, {_eol, line}}} ->
        exit_status(%{state | log: Log.add_line(state.log, line)}, timeout)
    after
      timeout -> {:timeout, state}
    end
  end
end
