defmodule Situ.Media.FFmpeg.Reader do
  @moduledoc false
  # A process that runs one `ffmpeg` and returns its decoded frames one by one on request, with media time in
  # nanoseconds. Nothing is read ahead: frames that are not requested stay in the socket, and `ffmpeg` waits.
  #
  # Pull frames with `next_frame/2`, or let the reader push them. After `request_frames(reader,
  # n)` the owner receives up to `n` messages `{Situ.Media.FFmpeg.Reader, reader, result}`.
  # `result` is `{:streams, streams}` (sent first, and not counted), `{:frame, frame}`, `:eof` or
  # `{:error, error}`. The last result is `:eof` if `ffmpeg` reported no errors. Otherwise it is
  # the error with the messages of `ffmpeg`, after all readable frames were returned.
  use GenServer, restart: :temporary, shutdown: 1_000

  alias Situ.Error
  alias Situ.Media.FFmpeg
  alias Situ.Media.FFmpeg.{Log, Socket}
  alias Situ.Media.Nut.Demuxer

  @schema [
    args: [
      type: {:list, :string},
      required: true,
      doc: "Input and output options, without the output."
    ],
    name: [type: :string, required: true, doc: "Name of the input, for errors."],
    connect_timeout: [
      type: {:or, [:pos_integer, :atom]},
      default: 30_000,
      doc: "Maximum time to open the input, ms, or `:infinity`."
    ],
    stall_timeout: [
      type: {:or, [:pos_integer, :atom]},
      default: :infinity,
      doc: "Maximum time to wait for more data of a frame, ms."
    ]
  ]

  defstruct [
    :owner,
    :port,
    :socket,
    :demuxer,
    :name,
    :stall,
    :connect,
    :finished,
    :status,
    credits: 0,
    announced: false,
    log: %Log{}
  ]

  @type result :: {:ok, Demuxer.frame()} | :eof | {:error, Error.t()}

  @doc """
  Starts `ffmpeg` and the process that reads from it. The process is linked to the caller, which becomes its owner.

  #{Situ.Options.docs(@schema)}
  """
  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, program} <- FFmpeg.fetch_executable("ffmpeg") do
      GenServer.start_link(__MODULE__, {self(), program, opts})
    end
  end

  @doc "Waits until `ffmpeg` has opened the input, and returns its streams."
  @spec fetch_streams(pid(), timeout()) :: {:ok, map()} | {:error, Error.t()}
  def fetch_streams(reader, timeout \\ 60_000), do: GenServer.call(reader, :streams, timeout)

  @doc "Waits for the next frame and returns it."
  @spec next_frame(pid(), timeout()) :: result()
  def next_frame(reader, timeout \\ 60_000), do: GenServer.call(reader, :next, timeout)

  @doc "Requests `n` more frames as messages to the owner."
  @spec request_frames(pid(), pos_integer()) :: :ok
  def request_frames(reader, n) when n > 0, do: GenServer.cast(reader, {:ask, n})

  @doc "Stops the reader and its `ffmpeg` immediately, even in the middle of a frame."
  @spec stop_ffmpeg(pid()) :: :ok
  def stop_ffmpeg(reader) do
    Process.unlink(reader)
    ref = Process.monitor(reader)
    Process.exit(reader, :kill)

    receive do
      {:DOWN, ^ref, _, _, _} -> :ok
    end
  end

  @impl true
  def init({owner, program, opts}) do
    state = %__MODULE__{
      owner: owner,
      name: opts[:name],
      stall: opts[:stall_timeout],
      connect: opts[:connect_timeout]
    }

    {:ok, state, {:continue, {:open, program, opts[:args]}}}
  end

  @impl true
  def handle_continue({:open, program, args}, state) do
    case Socket.open_listener() do
      {:ok, socket} ->
        out = ~w(-f nut -write_index 0 -flush_packets 1 -max_interleave_delta 500000
                 -max_muxing_queue_size 4096) ++ [Socket.ffmpeg_url(socket)]

        port = FFmpeg.start_program(program, FFmpeg.global_options() ++ args ++ out)
        {:noreply, connect_ffmpeg(%{state | port: port}, socket)}

      {:error, error} ->
        {:noreply, %{state | finished: {:error, error}}}
    end
  end

  def handle_continue(:pump, state), do: push_frames(state)

  @impl true
  def handle_call(:streams, _from, %{demuxer: nil, finished: finished} = state),
    do: {:reply, finished, state}

  def handle_call(:streams, _from, state),
    do: {:reply, {:ok, Demuxer.list_streams(state.demuxer)}, state}

  def handle_call(:next, _from, state) do
    {result, state} = read_frame(state)
    {:reply, result, state}
  end

  @impl true
  def handle_cast({:ask, n}, state),
    do: {:noreply, %{state | credits: state.credits + n}, {:continue, :pump}}

  @impl true
  def handle_info({port, {:data, {_eol, line}}}, %{port: port} = state),
    do: {:noreply, %{state | log: Log.add_line(state.log, line)}}

  # The remaining output of `ffmpeg` is still in the socket, so reading continues until the end of the output.
  def handle_info({port, {:exit_status, status}}, %{port: port} = state),
    do: {:noreply, %{state | status: status}}

  defp connect_ffmpeg(state, socket) do
    drain = fn log -> Log.take_lines(log, state.port) end
    {result, log} = Socket.accept_ffmpeg(socket, state.port, state.connect, state.log, drain)
    state = %{state | log: log}

    with {:ok, socket} <- result,
         {:ok, demuxer} <- Demuxer.open(fn n -> receive_bytes(socket, n, state.stall) end) do
      %{state | socket: socket, demuxer: demuxer}
    else
      {:error, reason} -> %{state | finished: {:error, open_error(reason, close_ffmpeg(state))}}
    end
  end

  # A single `recv` call can read at most 64 MiB.
  @largest 67_108_864

  defp receive_bytes(socket, n, timeout) when n <= @largest, do: :gen_tcp.recv(socket, n, timeout)

  defp receive_bytes(socket, n, timeout) do
    with {:ok, first} <- :gen_tcp.recv(socket, @largest, timeout),
         {:ok, rest} <- receive_bytes(socket, n - @largest, timeout),
         do: {:ok, first <> rest}
  end

  defp push_frames(%{announced: false} = state) do
    case state.finished do
      nil -> send_result(state, {:streams, Demuxer.list_streams(state.demuxer)})
      _ -> :ok
    end

    push_frames(%{state | announced: true})
  end

  defp push_frames(%{credits: 0} = state), do: {:noreply, state}

  defp push_frames(state) do
    case read_frame(state) do
      {{:ok, frame}, state} ->
        send_result(state, {:frame, frame})
        {:noreply, %{state | credits: state.credits - 1}, {:continue, :pump}}

      {ended, state} ->
        send_result(state, ended)
        {:noreply, %{state | credits: 0}}
    end
  end

  defp send_result(state, result), do: send(state.owner, {__MODULE__, self(), result})

  defp read_frame(%{finished: nil} = state) do
    state = %{state | log: Log.take_lines(state.log, state.port)}

    case Demuxer.next_frame(state.demuxer) do
      {:ok, frame, demuxer} -> {{:ok, frame}, %{state | demuxer: demuxer}}
      {:error, reason} -> finish_reading(reason, state)
    end
  end

  defp read_frame(state), do: {state.finished, state}

  # FFmpeg is about to exit only if its output has ended. After a stall, or output that cannot be parsed, it may never
  # exit by itself.
  defp finish_reading(reason, state) do
    {status, state} =
      if reason == :eof, do: exit_status(state), else: {:none, close_ffmpeg(state)}

    :gen_tcp.close(state.socket)
    result = end_result(reason, status, state)
    {result, %{state | finished: result}}
  end

  defp end_result(:eof, 0, %{log: %{count: 0}}), do: :eof

  defp end_result(:timeout, _status, state) do
    {:error,
     Log.to_error(state.log, :media_stalled, "#{state.name} stopped sending data",
       why: "no data for #{state.stall} ms"
     )}
  end

  defp end_result(reason, status, state) do
    {:error,
     Log.to_error(state.log, :damaged_media, "#{state.name} is damaged or truncated",
       meta: [status: status, reason: reason]
     )}
  end

  defp open_error(:timeout, state),
    do:
      Log.to_error(
        state.log,
        :media_timeout,
        "#{state.name} did not open within #{state.connect} ms"
      )

  defp open_error(reason, state) do
    Log.to_error(state.log, :unreadable_media, "cannot read #{state.name}", meta: [reason: reason])
  end

  defp exit_status(%{status: status} = state) when status != nil,
    do: {status, %{state | log: Log.take_lines(state.log, state.port)}}

  defp exit_status(%{port: port} = state) do
    receive do
      {^port, {:exit_status, status}} ->
        {status, %{state | log: Log.take_lines(state.log, port)}}

      {^port, {:data, {_eol, line}}} ->
        exit_status(%{state | log: Log.add_line(state.log, line)})
    after
      15_000 -> {:none, close_ffmpeg(state)}
    end
  end

  defp close_ffmpeg(state) do
    close_port(state.port)
    %{state | log: Log.take_lines(state.log, state.port)}
  end

  # The program, and with it its port, may end at any moment.
  defp close_port(port) do
    Port.close(port)
  rescue
    ArgumentError -> true
  end
end
