defmodule Situ.Bridge.Tcp.Server do
  @moduledoc false
  # Listens, and hands every frame to all clients that have room for it.
  use GenServer
  alias Situ.Bridge.Tcp.Client
  alias Situ.Error

  @most_clients 1_000

  defstruct [:listener, :acceptor, :most, clients: %{}, dropped: 0]

  @doc "Errors: `:address_in_use`, `:bad_address`."
  @spec open(String.t(), :inet.port_number(), pos_integer()) :: {:ok, pid()} | {:error, Error.t()}
  def open(interface, port, most) do
    with {:ok, listener} <- listen(interface, port) do
      {:ok, server} = GenServer.start_link(__MODULE__, {listener, most})
      :ok = :gen_tcp.controlling_process(listener, server)
      send(server, :begin)
      {:ok, server}
    end
  end

  defp listen(interface, port) do
    options = [:binary, active: false, reuseaddr: true, backlog: 128]

    with {:ok, ip} <- :inet.getaddr(String.to_charlist(interface), :inet),
         {:ok, listener} <- :gen_tcp.listen(port, [ip: ip] ++ options) do
      {:ok, listener}
    else
      {:error, :eaddrinuse} ->
        {:error, Error.new(:address_in_use, "port #{port} is in use", fix: "choose another")}

      {:error, reason} ->
        why = to_string(:inet.format_error(reason))
        {:error, Error.new(:bad_address, "cannot listen on #{interface}:#{port}", why: why)}
    end
  end

  def port(server), do: GenServer.call(server, :port)
  def clients(server), do: GenServer.call(server, :clients)
  def dropped(server), do: GenServer.call(server, :dropped)
  def send_frame(server, frame), do: GenServer.call(server, {:frame, frame}, :infinity)

  @doc "Waits until clients have taken everything, at most `timeout` ms, and closes."
  def close(server, timeout) do
    GenServer.call(
      server,
      {:drain, System.monotonic_time(:millisecond) + timeout},
      timeout + 5_000
    )

    GenServer.stop(server)
  catch
    :exit, _ -> :ok
  end

  @impl true
  def init({listener, most}) do
    Process.flag(:trap_exit, true)
    {:ok, %__MODULE__{listener: listener, most: most}}
  end

  @impl true
  def handle_call(:port, _from, state), do: {:reply, elem(:inet.port(state.listener), 1), state}
  def handle_call(:clients, _from, state), do: {:reply, map_size(state.clients), state}
  def handle_call(:dropped, _from, state), do: {:reply, state.dropped, state}

  def handle_call(:adopt, _from, state) when map_size(state.clients) >= @most_clients,
    do: {:reply, :full, state}

  def handle_call(:adopt, _from, state) do
    queued = :atomics.new(1, [])
    {:ok, client} = Client.start_link(queued)
    {:reply, client, %{state | clients: Map.put(state.clients, client, queued)}}
  end

  def handle_call({:frame, frame}, _from, state) do
    dropped = Enum.count(state.clients, &(put(&1, frame, state.most) == :full))
    {:reply, :ok, %{state | dropped: state.dropped + dropped}}
  end

  def handle_call({:drain, until}, from, state) do
    waiting? = Enum.any?(state.clients, fn {_, queued} -> :atomics.get(queued, 1) > 0 end)

    if waiting? and System.monotonic_time(:millisecond) < until do
      Process.send_after(self(), {:drain, from, until}, 5)
      {:noreply, state}
    else
      {:reply, :ok, state}
    end
  end

  defp put({client, queued}, frame, most) do
    if :atomics.get(queued, 1) < most do
      :atomics.add(queued, 1, 1)
      send(client, {:send, frame})
      :ok
    else
      :full
    end
  end

  @impl true
  def handle_info(:begin, state) do
    server = self()
    listener = state.listener
    {:noreply, %{state | acceptor: spawn_link(fn -> accept(listener, server) end)}}
  end

  def handle_info({:drain, from, until}, state) do
    with {:reply, reply, state} <- handle_call({:drain, until}, from, state) do
      GenServer.reply(from, reply)
      {:noreply, state}
    end
  end

  def handle_info({:EXIT, pid, reason}, %{acceptor: pid} = state), do: {:stop, reason, state}

  def handle_info({:EXIT, pid, reason}, state) do
    if is_map_key(state.clients, pid),
      do: {:noreply, %{state | clients: Map.delete(state.clients, pid)}},
      else: {:stop, reason, state}
  end

  # A server that ends well takes its connections along; their links would not.
  @impl true
  def terminate(_reason, state) do
    for {client, _} <- state.clients, do: Process.exit(client, :shutdown)
    :gen_tcp.close(state.listener)
  end

  # Runs in a process of its own.
  defp accept(listener, server) do
    case :gen_tcp.accept(listener) do
      {:ok, tcp} ->
        case GenServer.call(server, :adopt) do
          :full -> :gen_tcp.close(tcp)
          client -> Client.adopt(client, tcp)
        end

        accept(listener, server)

      {:error, :emfile} ->
        Process.sleep(100)
        accept(listener, server)

      {:error, _closed} ->
        :ok
    end
  end
end
