defmodule Situ.Media.StoredVideo.Transcoder do
  @moduledoc false
  # One `ffmpeg` that gets frames of one stream and returns frames: images become packets, or packets images. The caller
  # sends a frame and reads the result of it, so little is in flight.
  alias Situ.Error
  alias Situ.Media.FFmpeg.{Socket, Writer}
  alias Situ.Media.Nut.Demuxer

  @enforce_keys [:writer, :socket, :name]
  defstruct [:writer, :socket, :name, :accepted, :demuxer]
  @type t :: %__MODULE__{}

  # Maximum time to start, and to return a frame, in ms.
  @start_ms 30_000
  @frame_ms 30_000
  @poll_ms 20

  @doc """
  Starts `ffmpeg`, linked to the caller. `stream` describes the input (`Situ.Media.Nut.Muxer`), and `args` are the
  options of the output.
  """
  @spec start_link(map(), [String.t()], String.t(), [String.t()]) ::
          {:ok, t()} | {:error, Error.t()}
  def start_link(stream, args, name, input_args \\ []) do
    with {:ok, socket} <- Socket.open_listener() do
      output = ~w(-f nut -write_index 0 -flush_packets 1) ++ [Socket.ffmpeg_url(socket)]
      streams = [Map.merge(%{id: 0, class: :video}, stream)]

      own = [
        streams: streams,
        args: args ++ output,
        input_args: input_args,
        name: name,
        bound: true
      ]

      case Writer.start_link(own) do
        {:ok, writer} ->
          {:ok, %__MODULE__{writer: writer, socket: socket, name: name}}

        {:error, error} ->
          Socket.close_listener(socket)
          {:error, error}
      end
    end
  end

  @doc "Sends a frame at `time` ns (0 or more)."
  @spec write_frame(t(), non_neg_integer(), binary(), boolean()) :: :ok | {:error, Error.t()}
  def write_frame(coder, time, data, key?),
    do: Writer.write_frame(coder.writer, 0, time, {data, key?})

  @doc "Ends the input. The remaining frames can still be read."
  @spec end_input(t()) :: :ok
  def end_input(coder), do: Writer.end_input(coder.writer)

  @doc "Waits for the next frame. Returns `:eof` after the last one."
  @spec read_frame(t()) :: {:ok, Demuxer.frame(), t()} | :eof | {:error, Error.t()}
  def read_frame(%__MODULE__{demuxer: nil} = coder) do
    with {:ok, coder} <- accept_output(coder, System.monotonic_time(:millisecond) + @start_ms),
         do: read_frame(coder)
  end

  def read_frame(coder) do
    case Demuxer.next_frame(coder.demuxer) do
      {:ok, frame, demuxer} -> {:ok, frame, %{coder | demuxer: demuxer}}
      {:error, :eof} -> end_of_output(coder)
      {:error, reason} -> {:error, output_error(coder, reason)}
    end
  end

  @doc "Stops `ffmpeg` immediately."
  @spec close(t()) :: :ok
  def close(coder) do
    if coder.accepted,
      do: :gen_tcp.close(coder.accepted),
      else: Socket.close_listener(coder.socket)

    Process.unlink(coder.writer)
    ref = Process.monitor(coder.writer)
    Process.exit(coder.writer, :kill)

    receive do
      {:DOWN, ^ref, _, _, _} -> :ok
    end
  end

  # ffmpeg connects when it knows its input, or it ends with an error.
  defp accept_output(coder, deadline) do
    case :gen_tcp.accept(coder.socket.listen, @poll_ms) do
      {:ok, accepted} -> open_output(coder, accepted)
      {:error, :timeout} -> await_output(coder, deadline)
      {:error, reason} -> {:error, output_error(coder, reason)}
    end
  end

  defp await_output(coder, deadline) do
    with :ok <- Writer.check_running(coder.writer) do
      if System.monotonic_time(:millisecond) > deadline,
        do: {:error, output_error(coder, :timeout)},
        else: accept_output(coder, deadline)
    end
  end

  defp open_output(coder, accepted) do
    Socket.close_listener(coder.socket)
    coder = %{coder | accepted: accepted}

    case Demuxer.open(&:gen_tcp.recv(accepted, &1, @frame_ms)) do
      {:ok, demuxer} -> {:ok, %{coder | demuxer: demuxer}}
      {:error, :eof} -> end_of_output(coder)
      {:error, reason} -> {:error, output_error(coder, reason)}
    end
  end

  defp end_of_output(coder) do
    case Writer.await_end(coder.writer) do
      :ok -> :eof
      {:error, error} -> {:error, error}
    end
  end

  defp output_error(coder, reason) do
    Error.new(:media_stalled, "FFmpeg returned no data for #{coder.name}",
      why: "reading its output failed: #{inspect(reason)}"
    )
  end
end
