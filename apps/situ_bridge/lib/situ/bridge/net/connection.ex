defmodule Situ.Bridge.Net.Connection do
  @moduledoc false
  # One client of a server. After the protocol has admitted the client, this process sends it the messages from its
  # outbox, and ends when the client disconnects.
  use GenServer, restart: :temporary
  alias Situ.Bridge.Net.SendQueue

  @admission_ms 5_000
  # The maximum number of bytes that a client may send before it is admitted, or in one message afterwards. The
  # connection of a client that sends more is closed.
  @max_bytes 65_536

  def start_link(server, outbox, protocol),
    do: GenServer.start_link(__MODULE__, {server, outbox, protocol})

  @impl true
  def init({server, outbox, protocol}) do
    Process.send_after(self(), :too_slow, @admission_ms)

    {:ok,
     %{
       tcp: nil,
       server: server,
       outbox: outbox,
       protocol: protocol,
       received_bytes: "",
       open?: false
     }}
  end

  @impl true
  def handle_info({:adopt, tcp}, state) do
    :inet.setopts(tcp, SendQueue.socket_options())
    admit_client(%{state | tcp: tcp})
  end

  def handle_info({:send, frame}, state) do
    case SendQueue.flush(state.outbox, state.tcp, frame) do
      :ok -> {:noreply, state}
      {:error, reason} -> {:stop, {:shutdown, reason}, state}
    end
  end

  def handle_info({:tcp, _tcp, bytes}, state)
      when byte_size(bytes) + byte_size(state.received_bytes) > @max_bytes,
      do: {:stop, {:shutdown, :noise}, state}

  def handle_info({:tcp, _tcp, bytes}, %{open?: false} = state),
    do: admit_client(%{state | received_bytes: state.received_bytes <> bytes})

  def handle_info({:tcp, _tcp, bytes}, %{protocol: {module, arg}} = state) do
    case module.handle_bytes(state.received_bytes <> bytes, arg) do
      {:ok, reply, rest} -> send_reply(reply, %{state | received_bytes: rest})
      :close -> {:stop, {:shutdown, :closed}, state}
    end
  end

  def handle_info({:tcp_closed, _}, state), do: {:stop, {:shutdown, :closed}, state}
  def handle_info({:tcp_error, _, reason}, state), do: {:stop, {:shutdown, reason}, state}
  def handle_info(:too_slow, %{open?: true} = state), do: {:noreply, state}
  def handle_info(:too_slow, state), do: {:stop, {:shutdown, :too_slow}, state}

  defp admit_client(%{protocol: {module, arg}} = state) do
    case module.admit(state.received_bytes, arg) do
      {:ok, reply, rest} ->
        with {:noreply, state} <- send_reply(reply, %{state | received_bytes: rest, open?: true}) do
          send(state.server, {:open, self()})
          {:noreply, state}
        end

      :more ->
        send_reply("", state)

      {:refuse, reply} ->
        :gen_tcp.send(state.tcp, reply)
        {:stop, {:shutdown, :refused}, state}
    end
  end

  defp send_reply(reply, state) do
    case reply == "" || :gen_tcp.send(state.tcp, reply) do
      {:error, reason} ->
        {:stop, {:shutdown, reason}, state}

      _ ->
        :inet.setopts(state.tcp, active: :once)
        {:noreply, state}
    end
  end
end
