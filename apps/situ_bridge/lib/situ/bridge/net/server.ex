defmodule Situ.Bridge.Net.Server do
  @moduledoc false
  # Listens, and sends every message to all clients that have room for it.
  use GenServer
  alias Situ.Bridge.Net.{Connection, Drain, Listener, SendQueue}
  alias Situ.Bridge.PeerSender
  alias Situ.Error
  @behaviour PeerSender

  @max_clients 1_000

  defstruct [
    :listener,
    :acceptor,
    :max_queue,
    :protocol,
    :latch,
    :last_frame,
    clients: %{},
    dropped: 0
  ]

  @doc """
  Opens a port and serves a protocol on it; up to `max_queue` messages may wait for a client. With `latch: true`, a new
  client first receives the last message that was sent. Errors: `:address_in_use`, `:bad_address`.
  """
  @spec open(String.t(), :inet.port_number(), pos_integer(), {module(), term()}, keyword()) ::
          {:ok, pid()} | {:error, Error.t()}
  def open(interface, port, max_queue, protocol, opts \\ []) do
    with {:ok, listener} <- Listener.listen(interface, port) do
      state = %__MODULE__{
        listener: listener,
        max_queue: max_queue,
        protocol: protocol,
        latch: opts[:latch] || false
      }

      {:ok, server} = GenServer.start_link(__MODULE__, state)
      :ok = :gen_tcp.controlling_process(listener, server)
      send(server, :begin)
      {:ok, server}
    end
  end

  def port(server), do: GenServer.call(server, :port)

  @impl PeerSender
  def count_ready(server), do: GenServer.call(server, :ready)

  @impl PeerSender
  def count_dropped(server), do: GenServer.call(server, :dropped)

  @impl PeerSender
  def put(server, payload), do: GenServer.call(server, {:put, payload}, :infinity)

  @impl PeerSender
  defdelegate close(server, timeout), to: Drain

  @impl true
  def init(state) do
    Process.flag(:trap_exit, true)
    {:ok, state}
  end

  @impl true
  def handle_call(:port, _from, state), do: {:reply, Listener.port(state.listener), state}
  def handle_call(:ready, _from, state), do: {:reply, length(open_clients(state)), state}
  def handle_call(:dropped, _from, state), do: {:reply, state.dropped, state}

  def handle_call(:adopt, _from, state) when map_size(state.clients) >= @max_clients,
    do: {:reply, :full, state}

  def handle_call(:adopt, _from, state) do
    outbox = SendQueue.new()
    {:ok, client} = Connection.start_link(self(), outbox, state.protocol)
    {:reply, client, put_in(state.clients[client], %{outbox: outbox, open?: false})}
  end

  def handle_call({:put, payload}, _from, %{protocol: {module, arg}} = state) do
    frame = module.frame(payload, arg)

    dropped =
      Enum.count(open_clients(state), fn {pid, c} ->
        SendQueue.put(c.outbox, pid, frame, state.max_queue) == :full
      end)

    last = if state.latch, do: frame
    {:reply, :ok, %{state | dropped: state.dropped + dropped, last_frame: last}}
  end

  def handle_call({:drain, deadline}, from, state) do
    Drain.reply_when_drained(from, deadline, count_waiting(state), true)
    {:noreply, state}
  end

  defp open_clients(state), do: Enum.filter(state.clients, fn {_, client} -> client.open? end)

  defp count_waiting(state),
    do:
      state.clients |> Enum.map(fn {_, c} -> SendQueue.count_waiting(c.outbox) end) |> Enum.sum()

  @impl true
  def handle_info(:begin, state),
    do: {:noreply, %{state | acceptor: Listener.start_acceptor(state.listener, self())}}

  def handle_info({:drain, from, deadline}, state) do
    Drain.reply_when_drained(from, deadline, count_waiting(state), true)
    {:noreply, state}
  end

  def handle_info({:open, pid}, state) when is_map_key(state.clients, pid) do
    if state.last_frame,
      do: SendQueue.put(state.clients[pid].outbox, pid, state.last_frame, state.max_queue)

    {:noreply, put_in(state.clients[pid].open?, true)}
  end

  def handle_info({:open, _gone}, state), do: {:noreply, state}

  def handle_info({:EXIT, pid, _reason}, state) when is_map_key(state.clients, pid),
    do: {:noreply, %{state | clients: Map.delete(state.clients, pid)}}

  def handle_info({:EXIT, _pid, reason}, state), do: {:stop, reason, state}

  # A normal exit does not propagate through links, so the connections are stopped explicitly.
  @impl true
  def terminate(_reason, state) do
    for {client, _} <- state.clients, do: Process.exit(client, :shutdown)
    :gen_tcp.close(state.listener)
  end
end
