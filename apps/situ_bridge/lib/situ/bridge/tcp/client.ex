defmodule Situ.Bridge.Tcp.Client do
  @moduledoc false
  # One client of a server: writes what it is handed, and ends when the other side does.
  use GenServer, restart: :temporary

  @send_timeout 30_000

  def start_link(queued), do: GenServer.start_link(__MODULE__, queued)

  @doc "Hands over an accepted connection, whose owner is the caller."
  def adopt(client, tcp) do
    with :ok <- :gen_tcp.controlling_process(tcp, client), do: send(client, {:adopt, tcp})
  end

  @impl true
  def init(queued), do: {:ok, %{tcp: nil, queued: queued}}

  @impl true
  def handle_info({:adopt, tcp}, state) do
    options = [
      active: :once,
      nodelay: true,
      send_timeout: @send_timeout,
      send_timeout_close: true
    ]

    :inet.setopts(tcp, options)
    {:noreply, %{state | tcp: tcp}}
  end

  def handle_info({:send, frame}, state) do
    {n, frames} = gather(1, [frame])

    case :gen_tcp.send(state.tcp, Enum.reverse(frames)) do
      :ok ->
        :atomics.sub(state.queued, 1, n)
        {:noreply, state}

      {:error, reason} ->
        {:stop, {:shutdown, reason}, state}
    end
  end

  # A client has nothing to say; what it says all the same is let go.
  def handle_info({:tcp, tcp, _bytes}, state) do
    :inet.setopts(tcp, active: :once)
    {:noreply, state}
  end

  def handle_info({:tcp_closed, _}, state), do: {:stop, {:shutdown, :closed}, state}
  def handle_info({:tcp_error, _, reason}, state), do: {:stop, {:shutdown, reason}, state}

  # One call into the kernel for whatever waits.
  defp gather(n, frames) when n >= 500, do: {n, frames}

  defp gather(n, frames) do
    receive do
      {:send, frame} -> gather(n + 1, [frame | frames])
    after
      0 -> {n, frames}
    end
  end
end
