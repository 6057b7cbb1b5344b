defmodule Situ.Live.Yaws.WebSocket do
  @moduledoc false
  # Maps Yaws's callbacks, in the process of one WebSocket, to the callbacks of `Situ.Live.SocketHandler`.
  require Logger
  alias Situ.Live.Connections

  @compile {:no_warn_undefined, [:yaws_websockets]}

  defstruct [:handler, :arg, :request, :ref, :last_seen, :state, open?: false]

  # The handler starts in handle_open, because nothing may be sent earlier.
  def init([_arg, {{handler, arg, _opts, request}, ref}]) do
    {:ok,
     %__MODULE__{
       handler: handler,
       arg: arg,
       request: request,
       ref: ref,
       last_seen: Connections.register(ref)
     }}
  end

  def handle_open(connection, %__MODULE__{} = socket) do
    case with_crash_guard(fn -> socket.handler.init(socket.request, socket.arg) end) do
      {:ok, state} -> {:ok, put_open_state(socket, state)}
      {:push, frames, state} -> push_first(connection, frames, put_open_state(socket, state))
      {:error, reason} when is_binary(reason) -> {:error, {1008, reason}}
      _ -> {:error, {1011, "internal error"}}
    end
  end

  defp put_open_state(socket, state),
    do: %{socket | state: state, open?: true, request: nil, arg: nil}

  defp push_first(connection, frames, socket) do
    Enum.each(to_frames(frames), &:yaws_websockets.send(connection, &1))
    {:ok, socket}
  end

  def handle_message({opcode, data}, %__MODULE__{} = socket) when opcode in [:text, :binary] do
    Connections.touch(socket.last_seen)

    with_crash_guard(fn -> socket.handler.handle_in({data, opcode: opcode}, socket.state) end)
    |> to_yaws_result(socket)
  end

  def handle_message({:close, status, _reason}, socket) do
    {:close, if(status in 1000..1003 or status in 3000..4999, do: status, else: :normal), socket}
  end

  def handle_info(message, %__MODULE__{} = socket) do
    cond do
      not socket.open? ->
        {:noreply, socket}

      function_exported?(socket.handler, :handle_info, 2) ->
        with_crash_guard(fn -> socket.handler.handle_info(message, socket.state) end)
        |> to_yaws_result(socket)

      true ->
        {:noreply, socket}
    end
  end

  def terminate(reason, %__MODULE__{open?: true} = socket) do
    if function_exported?(socket.handler, :terminate, 2),
      do: with_crash_guard(fn -> socket.handler.terminate(reason, socket.state) end)
  end

  def terminate(_, _), do: :ok

  defp to_yaws_result({:ok, state}, socket), do: {:noreply, %{socket | state: state}}

  defp to_yaws_result({:push, frames, state}, socket),
    do: {:reply, to_frames(frames), %{socket | state: state}}

  defp to_yaws_result({:stop, :normal, state}, socket),
    do: {:close, :normal, %{socket | state: state}}

  defp to_yaws_result({:stop, {code, reason}, state}, socket)
       when is_integer(code) and is_binary(reason),
       do: {:close, {code, reason}, %{socket | state: state}}

  defp to_yaws_result({:stop, _, state}, socket),
    do: {:close, {1011, "internal error"}, %{socket | state: state}}

  defp to_yaws_result(:raised, socket), do: {:close, {1011, "internal error"}, socket}

  defp to_yaws_result(other, socket) do
    Logger.error("invalid result of #{inspect(socket.handler)}: #{inspect(other, limit: 5)}")
    {:close, {1011, "internal error"}, socket}
  end

  defp to_frames(frames) when is_list(frames), do: Enum.map(frames, &to_frame/1)
  defp to_frames(frame), do: [to_frame(frame)]

  # Yaws requires one binary per frame.
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
