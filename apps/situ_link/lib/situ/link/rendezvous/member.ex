defmodule Situ.Link.Rendezvous.Member do
  @moduledoc false
  # Takes part in a rendezvous for one process: announces it, tracks the others, and reconnects when the server was
  # unreachable.
  #
  # The server silently ignores a name that belongs to another process, but it sends the list of all processes,
  # including this one, to every client. So the first entry with the own name shows who owns it: `name` is `:ours` or
  # `:taken`.
  use GenServer
  require Logger
  alias Situ.Link.Rendezvous.{Directory, Protocol}

  @min_wait_ms 50
  @max_wait_ms 5_000
  @greeting_ms 10_000

  defstruct [
    :host,
    :port,
    :entry,
    :listener,
    :socket,
    :error,
    :name,
    wait_ms: @min_wait_ms,
    stage: nil,
    buffer: "",
    parser: nil,
    peers: %{}
  ]

  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, opts)

  @impl true
  def init(opts) do
    send(self(), :connect)
    entry = %{name: opts[:name], version: opts[:version], endpoints: opts[:endpoints]}

    {:ok,
     %__MODULE__{host: opts[:host], port: opts[:port], entry: entry, listener: opts[:listener]}}
  end

  @impl true
  def handle_call(:peers, _from, state),
    do: {:reply, for({_name, process} <- Enum.sort(state.peers), do: process), state}

  def handle_call(:error, _from, state) do
    error =
      if state.name == :taken, do: Directory.name_taken_text(state.entry.name), else: state.error

    {:reply, error, state}
  end

  def handle_call({:announce, endpoints}, _from, state) do
    state = %{state | entry: %{state.entry | endpoints: endpoints}}
    send_announcement(state)
    {:reply, :ok, state}
  end

  @impl true
  def handle_info(:connect, %{socket: nil} = state) do
    options =
      [:binary, active: :once, nodelay: true, send_timeout: 5_000] ++ Situ.TcpKeepalive.options()

    case :gen_tcp.connect(String.to_charlist(state.host), state.port, options, 5_000) do
      {:ok, socket} ->
        _ = :gen_tcp.send(socket, <<Protocol.protocol_version()::little-signed-16>>)
        Process.send_after(self(), {:greeted?, socket}, @greeting_ms)
        {:noreply, %{state | socket: socket, stage: :greeting, buffer: "", parser: nil}}

      {:error, reason} ->
        {:noreply, schedule_reconnect(state, to_string(:inet.format_error(reason)))}
    end
  end

  def handle_info({:tcp, socket, bytes}, %{socket: socket} = state) do
    _ = :inet.setopts(socket, active: :once)
    {:noreply, handle_buffer(%{state | buffer: state.buffer <> bytes})}
  end

  def handle_info({:greeted?, socket}, %{socket: socket, stage: stage} = state)
      when stage != :open,
      do:
        {:noreply,
         schedule_reconnect(state, "no greeting within 10 s: is it a rendezvous server?")}

  def handle_info({:tcp_closed, socket}, %{socket: socket} = state),
    do: {:noreply, schedule_reconnect(state, "the server closed the connection")}

  def handle_info({:tcp_error, socket, reason}, %{socket: socket} = state),
    do: {:noreply, schedule_reconnect(state, inspect(reason))}

  def handle_info(_other, state), do: {:noreply, state}

  defp handle_buffer(
         %{stage: :greeting, buffer: <<version::little-signed-16, rest::binary>>} = state
       ) do
    if version == Protocol.protocol_version(),
      do: handle_buffer(%{state | stage: :listed, buffer: rest}),
      else:
        schedule_reconnect(
          state,
          "the server uses protocol version #{version}, this client #{Protocol.protocol_version()}"
        )
  end

  # Skips the address of this client as seen by the server, and the number of processes. Peers of the previous
  # connection are discarded.
  defp handle_buffer(%{stage: :listed, buffer: buffer} = state) do
    with {:ok, _address, rest} <- Protocol.read_text(buffer),
         {:ok, _count, rest} <- Protocol.read_int(rest) do
      state = %{state | stage: :open, buffer: rest, wait_ms: @min_wait_ms, error: nil, name: nil}
      state = %{state | peers: %{}}
      send_announcement(state)
      handle_buffer(state)
    else
      :more -> state
      {:error, why} -> schedule_reconnect(state, why)
    end
  end

  defp handle_buffer(%{stage: :open, buffer: ""} = state), do: state

  defp handle_buffer(%{stage: :open, buffer: buffer} = state) do
    case (state.parser || (&Protocol.feed/1)).(buffer) do
      {:ok, update, rest} ->
        handle_buffer(handle_update(%{state | buffer: rest, parser: nil}, update))

      {:more, parser} ->
        %{state | buffer: "", parser: parser}

      {:error, why} ->
        schedule_reconnect(state, why)
    end
  end

  defp handle_buffer(state), do: state

  defp handle_update(%{entry: %{name: name}} = state, {:add, %{name: name} = process}) do
    cond do
      state.name == :ours or process == state.entry ->
        %{state | name: :ours}

      state.name == :taken ->
        state

      true ->
        Logger.warning("situ rendezvous: " <> Directory.name_taken_text(name))
        notify_listener(state, {:taken, name})
        %{state | name: :taken}
    end
  end

  # The entry of another process, or of a lost connection, was removed, so the name is free. If it was this process
  # changing its endpoints, the server ignores the second announcement.
  defp handle_update(%{entry: %{name: name}} = state, {:remove, name}) do
    send_announcement(state)
    %{state | name: nil}
  end

  defp handle_update(state, {:add, process}) do
    notify_listener(state, {:added, process})
    %{state | peers: Map.put(state.peers, process.name, process)}
  end

  defp handle_update(state, {:remove, name}) do
    notify_listener(state, {:removed, name})
    %{state | peers: Map.delete(state.peers, name)}
  end

  defp handle_update(state, :disconnect), do: state

  defp notify_listener(%{listener: nil}, _event), do: :ok
  defp notify_listener(state, event), do: send(state.listener, {:situ_rendezvous, self(), event})

  defp send_announcement(%{stage: :open, socket: socket} = state),
    do: :gen_tcp.send(socket, Protocol.encode({:add, state.entry}))

  defp send_announcement(_state), do: :ok

  defp schedule_reconnect(state, why) do
    if state.socket, do: :gen_tcp.close(state.socket)
    for {name, _} <- state.peers, do: notify_listener(state, {:removed, name})
    Process.send_after(self(), :connect, state.wait_ms)

    %{
      state
      | socket: nil,
        stage: nil,
        buffer: "",
        peers: %{},
        name: nil,
        error: why,
        wait_ms: min(state.wait_ms * 2, @max_wait_ms)
    }
  end

  @impl true
  def terminate(_reason, %{socket: nil}), do: :ok

  def terminate(_reason, state) do
    _ = :gen_tcp.send(state.socket, Protocol.encode(:disconnect))
    :gen_tcp.close(state.socket)
  end
end
