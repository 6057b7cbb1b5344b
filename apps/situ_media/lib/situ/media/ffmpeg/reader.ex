defmodule Situ.Media.FFmpeg.Reader do
  @moduledoc """
  A process that runs one `ffmpeg` and hands out the frames it decodes, one when asked for one.

  Nothing is read ahead: what nobody asked for stays in the socket, and `ffmpeg` waits. Frames carry media time in
  nanoseconds (`Situ.Media.Nut.Demuxer`).

      {:ok, reader} = Situ.Media.FFmpeg.Reader.start_link(
        args: Situ.Media.FFmpeg.local_file("talk.mp4") ++ ~w(-c:v rawvideo -pix_fmt bgr24 -an), name: "talk.mp4")
      {:ok, streams} = Situ.Media.FFmpeg.Reader.streams(reader)
      {:ok, %{stream: 0, time: 0, data: pixels}} = Situ.Media.FFmpeg.Reader.next(reader)

  Pull with `next/2`, or let the reader push: after `ask(reader, n)` the owner gets up to `n` messages
  `{Situ.Media.FFmpeg.Reader, reader, result}` with `result` one of `{:streams, streams}` (first, costs nothing),
  `{:frame, frame}`, `:eof`, `{:error, error}`.

  The end is `:eof` when `ffmpeg` was content, otherwise `{:error, error}`: after everything readable was handed out,
  with what `ffmpeg` complained about.
  """
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
    name: [type: :string, required: true, doc: "The input's name, for errors."],
    connect_timeout: [
      type: {:or, [:pos_integer, :atom]},
      default: 30_000,
      doc: "How long opening may take, ms, or `:infinity`."
    ],
    stall_timeout: [
      type: {:or, [:pos_integer, :atom]},
      default: :infinity,
      doc: "How long to wait for more of one frame, ms."
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
  Starts `ffmpeg` and the process that reads from it, linked to the caller, who is its owner.

  #{Situ.Options.docs(@schema)}
  """
  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, program} <- FFmpeg.executable("ffmpeg") do
      GenServer.start_link(__MODULE__, {self(), program, opts})
    end
  end

  @doc "The streams in what is read; waits until `ffmpeg` has opened it."
  @spec streams(pid(), timeout()) :: {:ok, map()} | {:error, Error.t()}
  def streams(reader, timeout \\ 60_000), do: GenServer.call(reader, :streams, timeout)

  @doc "The next frame; waits for it."
  @spec next(pid(), timeout()) :: result()
  def next(reader, timeout \\ 60_000), do: GenServer.call(reader, :next, timeout)

  @doc "Lets the reader send `n` more frames to its owner."
  @spec ask(pid(), pos_integer()) :: :ok
  def ask(reader, n) when n > 0, do: GenServer.cast(reader, {:ask, n})

  @doc "Ends the reader and its `ffmpeg` at once, even in the middle of a frame."
  @spec stop(pid()) :: :ok
  def stop(reader) do
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
    case Socket.listen() do
      {:ok, socket} ->
        out = ~w(-f nut -write_index 0 -flush_packets 1 -max_interleave_delta 500000
                 -max_muxing_queue_size 4096) ++ [Socket.url(socket)]

        port = FFmpeg.start(program, FFmpeg.global_options() ++ args ++ out)
        {:noreply, connect(%{state | port: port}, socket)}

      {:error, error} ->
        {:noreply, %{state | finished: {:error, error}}}
    end
  end

  def handle_continue(:pump, state), do: pump(state)

  @impl true
  def handle_call(:streams, _from, %{demuxer: nil, finished: finished} = state),
    do: {:reply, finished, state}

  def handle_call(:streams, _from, state),
    do: {:reply, {:ok, Demuxer.streams(state.demuxer)}, state}

  def handle_call(:next, _from, state) do
    {result, state} = read(state)
    {:reply, result, state}
  end

  @impl true
  def handle_cast({:ask, n}, state),
    do: {:noreply, %{state | credits: state.credits + n}, {:continue, :pump}}

  @impl true
  def handle_info({port, {:data, {_eol, line}}}, %{port: port} = state),
    do: {:noreply, %{state | log: Log.add(state.log, line)}}

  # Its output still waits in the socket: the end of that is the end.
  def handle_info({port, {:exit_status, status}}, %{port: port} = state),
    do: {:noreply, %{state | status: status}}

  defp connect(state, socket) do
    drain = fn log -> Log.drain(log, state.port) end
    {result, log} = Socket.accept(socket, state.port, state.connect, state.log, drain)
    state = %{state | log: log}

    with {:ok, socket} <- result,
         {:ok, demuxer} <- Demuxer.open(fn n -> receive_bytes(socket, n, state.stall) end) do
      %{state | socket: socket, demuxer: demuxer}
    else
      {:error, reason} -> %{state | finished: {:error, open_error(reason, close(state))}}
    end
  end

  # A single call may ask for at most 64 MiB.
  @largest 67_108_864

  defp receive_bytes(socket, n, timeout) when n <= @largest, do: :gen_tcp.recv(socket, n, timeout)

  defp receive_bytes(socket, n, timeout) do
    with {:ok, first} <- :gen_tcp.recv(socket, @largest, timeout),
         {:ok, rest} <- receive_bytes(socket, n - @largest, timeout),
         do: {:ok, first <> rest}
  end

  defp pump(%{announced: false} = state) do
    case state.finished do
      nil -> tell(state, {:streams, Demuxer.streams(state.demuxer)})
      _ -> :ok
    end

    pump(%{state | announced: true})
  end

  defp pump(%{credits: 0} = state), do: {:noreply, state}

  defp pump(state) do
    case read(state) do
      {{:ok, frame}, state} ->
        tell(state, {:frame, frame})
        {:noreply, %{state | credits: state.credits - 1}, {:continue, :pump}}

      {ended, state} ->
        tell(state, ended)
        {:noreply, %{state | credits: 0}}
    end
  end

  defp tell(state, result), do: send(state.owner, {__MODULE__, self(), result})

  defp read(%{finished: nil} = state) do
    state = %{state | log: Log.drain(state.log, state.port)}

    case Demuxer.next(state.demuxer) do
      {:ok, frame, demuxer} -> {{:ok, frame}, %{state | demuxer: demuxer}}
      {:error, reason} -> finish(reason, state)
    end
  end

  defp read(state), do: {state.finished, state}

  # FFmpeg is about to exit only if its output has ended. After a stall, or output that cannot be parsed, it may never
  # exit by itself.
  defp finish(reason, state) do
    {status, state} = if reason == :eof, do: exit_status(state), else: {:none, close(state)}
    :gen_tcp.close(state.socket)
    result = verdict(reason, status, state)
    {result, %{state | finished: result}}
  end

  defp verdict(:eof, 0, %{log: %{count: 0}}), do: :eof

  defp verdict(:timeout, _status, state) do
    {:error,
     Log.to_error(state.log, :media_stalled, "#{state.name} sends nothing any more",
       why: "no data for #{state.stall} ms"
     )}
  end

  defp verdict(reason, status, state) do
    {:error,
     Log.to_error(state.log, :damaged_media, "#{state.name} is damaged or ends too early",
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
    do: {status, %{state | log: Log.drain(state.log, state.port)}}

  defp exit_status(%{port: port} = state) do
    receive do
      {^port, {:exit_status, status}} ->
        {status, %{state | log: Log.drain(state.log, port)}}

      {^port, {:data, {_eol, line}}} ->
        exit_status(%{state | log: Log.add(state.log, line)})
    after
      15_000 -> {:none, close(state)}
    end
  end

  defp close(state) do
    close_port(state.port)
    %{state | log: Log.drain(state.log, state.port)}
  end

  # The program may end at any moment, and its port with it.
  defp close_port(port) do
    Port.close(port)
  rescue
    ArgumentError -> true
  end
end
