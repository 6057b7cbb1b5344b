defmodule Situ.Python.Connection do
  @moduledoc false
  # The socket between a component and its program. The component listens, and the program connects.

  @buffer_bytes 1_048_576

  @doc """
  Listens at `path`. The calling process receives `{:accepted, socket}` when the program has connected, and owns the
  socket.
  """
  @spec listen(Path.t()) :: {:ok, :gen_tcp.socket()} | {:error, term()}
  def listen(path) do
    options = [:binary, packet: 4, active: false, backlog: 1, ifaddr: {:local, path}]

    with {:ok, listener} <- :gen_tcp.listen(0, options) do
      accept_connection(listener)
      {:ok, listener}
    end
  end

  # Accepting blocks, so a linked process does it.
  defp accept_connection(listener) do
    owner = self()

    {:ok, _task} =
      Task.start_link(fn ->
        with {:ok, socket} <- :gen_tcp.accept(listener),
             :ok <- :gen_tcp.controlling_process(socket, owner),
             do: send(owner, {:accepted, socket})
      end)
  end

  @doc "Starts to deliver frames to the calling process."
  @spec activate(:gen_tcp.socket()) :: :ok | {:error, term()}
  def activate(socket) do
    :inet.setopts(socket, active: true, sndbuf: @buffer_bytes, recbuf: @buffer_bytes)
  end

  @doc "Sends a frame. If the connection has ended, so has the program, and its exit status is about to arrive."
  @spec send_frame(:gen_tcp.socket() | nil, iodata()) :: :ok
  def send_frame(nil, _frame), do: :ok

  def send_frame(socket, frame) do
    _ = :gen_tcp.send(socket, frame)
    :ok
  end
end
