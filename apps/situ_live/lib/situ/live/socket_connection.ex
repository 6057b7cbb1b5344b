defmodule Situ.Live.SocketConnection do
  @moduledoc """
  A WebSocket as a value: an adapter (`Situ.Live.Adapter`) holds it in the process of the connection, passes frames and
  messages to it, and carries out the results. It calls the `Situ.Live.SocketHandler` of the route. An exception in a
  handler is logged and closes the connection.
  """
  require Logger
  alias Situ.Live.{Connections, Request, SocketHandler}

  # The log shows the state of a process that fails, so cookies and tokens must not be inspected.
  @derive {Inspect, only: [:handler, :ref, :open?]}
  defstruct [:handler, :arg, :request, :ref, :last_seen, :state, open?: false]

  @opaque t :: %__MODULE__{}

  @typedoc "Sends the frames, or closes the connection with a status code and a reason."
  @type result ::
          {:send, [{:text | :binary, binary()}], t()}
          | {:close, {1000..4999, String.t()}, t()}

  @doc false
  @spec new(reference(), {module(), term(), Request.t()}) :: t()
  def new(ref, {handler, arg, request}),
    do: %__MODULE__{handler: handler, arg: arg, request: request, ref: ref}

  @doc "Begins the connection. The process that calls it is the process of the connection."
  @spec open(t()) :: result()
  def open(%__MODULE__{} = socket) do
    socket = %{socket | last_seen: Connections.register(socket.ref)}

    case with_crash_guard(fn -> socket.handler.init(socket.request, socket.arg) end) do
      {:error, reason} when is_binary(reason) -> {:close, {1008, reason}, socket}
      :raised -> {:close, {1011, "internal error"}, socket}
      result -> to_result(result, %{socket | open?: true, request: nil, arg: nil})
    end
  end

  @doc "Handles a message from the browser."
  @spec handle_frame(t(), :text | :binary, binary()) :: result()
  def handle_frame(%__MODULE__{} = socket, opcode, data) do
    Connections.touch(socket.last_seen)

    with_crash_guard(fn -> socket.handler.handle_in({data, opcode: opcode}, socket.state) end)
    |> to_result(socket)
  end

  @doc "Handles a message to the process of the connection."
  @spec handle_info(t(), term()) :: result()
  def handle_info(%__MODULE__{} = socket, message) do
    if socket.open? and function_exported?(socket.handler, :handle_info, 2) do
      with_crash_guard(fn -> socket.handler.handle_info(message, socket.state) end)
      |> to_result(socket)
    else
      {:send, [], socket}
    end
  end

  @doc "Reports the end of the connection to the handler."
  @spec terminate(t(), term()) :: :ok
  def terminate(%__MODULE__{open?: true} = socket, reason) do
    if function_exported?(socket.handler, :terminate, 2),
      do: with_crash_guard(fn -> socket.handler.terminate(reason, socket.state) end)

    :ok
  end

  def terminate(_socket, _reason), do: :ok

  @spec to_result(SocketHandler.result() | term(), t()) :: result()
  defp to_result({:ok, state}, socket), do: {:send, [], %{socket | state: state}}

  defp to_result({:push, frames, state}, socket),
    do: {:send, to_frames(frames), %{socket | state: state}}

  defp to_result({:stop, :normal, state}, socket),
    do: {:close, {1000, ""}, %{socket | state: state}}

  defp to_result({:stop, {code, reason}, state}, socket)
       when is_integer(code) and is_binary(reason),
       do: {:close, {code, reason}, %{socket | state: state}}

  defp to_result({:stop, _, state}, socket),
    do: {:close, {1011, "internal error"}, %{socket | state: state}}

  defp to_result(:raised, socket), do: {:close, {1011, "internal error"}, socket}

  defp to_result(other, socket) do
    Logger.error("invalid result of #{inspect(socket.handler)}: #{inspect(other, limit: 5)}")
    {:close, {1011, "internal error"}, socket}
  end

  defp to_frames(frames) when is_list(frames), do: Enum.map(frames, &to_frame/1)
  defp to_frames(frame), do: [to_frame(frame)]

  # Web servers require one binary per frame.
  defp to_frame({opcode, data}) when opcode in [:text, :binary],
    do: {opcode, IO.iodata_to_binary(data)}

  # An uncaught exception would be reported with the state of the process, including cookies and tokens.
  defp with_crash_guard(fun) do
    fun.()
  catch
    kind, reason ->
      Logger.error(Exception.format(kind, reason, __STACKTRACE__))
      :raised
  end
end
