defmodule Situ.Bridge.ZeroMQ.SharedPublisher do
  @moduledoc false
  # One publishing socket shared by several streams of a pipeline, each with a separate topic. It opens with the
  # pipeline and closes when the last stream or the pipeline has ended.
  use GenServer, restart: :temporary
  alias Situ.Bridge.PeerSender
  alias Situ.Bridge.ZeroMQ.Socket
  alias Situ.Error
  @behaviour PeerSender

  @max_bytes 64 * 1024 * 1024

  @enforce_keys [:server]
  defstruct [:server]
  @type t :: %__MODULE__{server: pid()}

  @doc "Starts the publisher without a link, so that messages in flight are still sent when a pipeline ends."
  @spec start(pid(), String.t(), keyword()) :: t()
  def start(pipeline, address, opts) do
    {:ok, server} = GenServer.start(__MODULE__, {pipeline, address, opts})
    %__MODULE__{server: server}
  end

  @doc "Registers another stream."
  @spec expect_stream(t()) :: :ok
  def expect_stream(%__MODULE__{server: server}), do: GenServer.call(server, :expect)

  @doc "Opens the socket for a stream; returns its handle and the listening port. Errors: see `Socket.open/3`."
  @spec open_stream(t()) ::
          {:ok, {pid(), pid()}, :inet.port_number() | nil} | {:error, Error.t()}
  def open_stream(%__MODULE__{server: server}), do: GenServer.call(server, :open, :infinity)

  @impl PeerSender
  def count_ready({_server, socket}), do: Socket.count_ready(socket)
  @impl PeerSender
  def count_dropped({_server, socket}), do: Socket.count_dropped(socket)
  @impl PeerSender
  def put({_server, socket}, frames), do: Socket.put(socket, frames)

  @impl PeerSender
  def close({server, _socket}, timeout) do
    GenServer.call(server, {:close, timeout}, timeout + 10_000)
  catch
    :exit, _ -> 0
  end

  @impl GenServer
  def init({pipeline, address, opts}) do
    Process.monitor(pipeline)
    {:ok, %{address: address, opts: opts, socket: nil, streams: 0}}
  end

  @impl GenServer
  def handle_call(:expect, _from, state), do: {:reply, :ok, %{state | streams: state.streams + 1}}

  def handle_call(:open, _from, %{socket: nil} = state) do
    case Socket.open(:pub, state.address, [most: @max_bytes] ++ state.opts) do
      {:ok, socket} -> {:reply, open_reply(socket, state), %{state | socket: socket}}
      error -> {:reply, error, state}
    end
  end

  def handle_call(:open, _from, state), do: {:reply, open_reply(state.socket, state), state}

  def handle_call({:close, timeout}, _from, %{streams: 1} = state) do
    lost_count = if state.socket, do: Socket.close(state.socket, timeout), else: 0
    {:stop, :normal, lost_count, %{state | socket: nil}}
  end

  def handle_call({:close, _timeout}, _from, state),
    do: {:reply, 0, %{state | streams: state.streams - 1}}

  defp open_reply(socket, state),
    do: {:ok, {self(), socket}, if(state.opts[:bind], do: Socket.port(socket))}

  @impl GenServer
  def handle_info({:DOWN, _, :process, _, _}, state), do: {:stop, :normal, state}
  def handle_info(_other, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, %{socket: nil}), do: :ok
  def terminate(_reason, state), do: Socket.close(state.socket, 0)
end
