defmodule Situ.Link.Nats.Connection do
  @moduledoc false
  # Connects to one of several NATS servers, for requests with replies. When the connection is lost, requests in
  # flight return `{:error, :down}`, and it tries the servers in turn until one accepts. With `subscriber:` (a
  # process) and `subjects:`, it sends the messages of these subjects to the subscriber as `{:nats, connection,
  # message}`, and `{:nats, connection, :up}` each time it has connected.
  use GenServer

  alias Situ.{Error, JSON}
  alias Situ.Link.Nats.{Dialer, Protocol}
  require Logger

  # Space for the headers of requests and replies, in addition to the payload.
  @header_space 65_536
  @retry_ms 100

  defstruct [
    :servers,
    :first_server,
    :opts,
    :socket,
    :transport,
    :inbox,
    :info,
    :logged,
    buffer: "",
    id: 0,
    pending: %{}
  ]

  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, opts)

  @doc "Starts a connection that is not linked to its caller and runs until it is closed."
  @spec start(keyword()) :: GenServer.on_start()
  def start(opts), do: GenServer.start(__MODULE__, opts)

  @doc "Sends a message and waits `timeout` ms for its reply."
  @spec request(pid(), String.t(), [{String.t(), String.t()}], iodata(), pos_integer()) ::
          {:ok, Protocol.message()} | {:error, :down | :timeout}
  def request(connection, subject, headers, data, timeout) do
    GenServer.call(connection, {:request, subject, headers, data, timeout}, timeout + 5_000)
  catch
    :exit, _ -> {:error, :down}
  end

  @doc "Sends a message without waiting for a reply. Without a connection it is dropped."
  @spec publish(pid(), String.t(), String.t(), iodata()) :: :ok
  def publish(connection, subject, reply, data),
    do: GenServer.cast(connection, {:publish, subject, reply, data})

  @doc "Returns the server's information about itself, or `nil` without a connection."
  @spec server_info(pid()) :: map() | nil
  def server_info(connection) do
    GenServer.call(connection, :info, 10_000)
  catch
    :exit, _ -> nil
  end

  @impl true
  def init(opts) do
    state = %__MODULE__{servers: opts[:servers], first_server: hd(opts[:servers]), opts: opts}

    case connect_any(state, length(state.servers), nil) do
      {:ok, state} ->
        {:ok, state}

      {:error, %{code: :log_away} = error} ->
        if opts[:wait], do: start_waiting(state, error), else: stop_init(error)

      {:error, error} ->
        stop_init(error)
    end
  end

  defp stop_init(error), do: {:stop, {:shutdown, error}}

  # Waits for a server that is not running yet, in the same way as for a lost one.
  defp start_waiting(state, error) do
    Process.send_after(self(), :connect, @retry_ms)
    {:ok, warn_waiting(state, error)}
  end

  # Logs each reason once, and the end of the wait once.
  defp warn_waiting(%{logged: logged} = state, %Error{what: logged}), do: state

  defp warn_waiting(state, %Error{} = error) do
    Logger.warning("waiting for NATS: #{Exception.message(error)}")
    %{state | logged: error.what}
  end

  defp log_connected(%{logged: nil} = state), do: state

  defp log_connected(state) do
    Logger.warning("connected to the NATS server at #{server_name(state)}")
    %{state | logged: nil}
  end

  defp connect_any(_state, 0, error), do: {:error, error}

  defp connect_any(state, tries, _error) do
    case connect_next(state) do
      {:ok, state} -> {:ok, state}
      {:error, error} -> connect_any(next_server(state), tries - 1, error)
    end
  end

  defp next_server(%{servers: [server | rest]} = state), do: %{state | servers: rest ++ [server]}

  @impl true
  def handle_call(:info, _from, state), do: {:reply, state.info, state}

  def handle_call({:request, _, _, _, _}, _from, %{socket: nil} = state),
    do: {:reply, {:error, :down}, state}

  def handle_call({:request, subject, headers, data, timeout}, from, state) do
    id = state.id + 1
    reply = "#{state.inbox}.#{id}"

    case state.transport.send(
           state.socket,
           Protocol.encode_publish(subject, reply, headers, data)
         ) do
      :ok ->
        timer = Process.send_after(self(), {:late, id}, timeout)
        pending = Map.put(state.pending, id, {from, timer})
        {:noreply, %{state | id: id, pending: pending}}

      {:error, _} ->
        {:reply, {:error, :down}, handle_disconnect(state)}
    end
  end

  @impl true
  def handle_cast({:publish, _, _, _}, %{socket: nil} = state), do: {:noreply, state}

  def handle_cast({:publish, subject, reply, data}, state) do
    case state.transport.send(state.socket, Protocol.encode_publish(subject, reply, [], data)) do
      :ok -> {:noreply, state}
      {:error, _} -> {:noreply, handle_disconnect(state)}
    end
  end

  @impl true
  def handle_info({kind, socket, data}, %{socket: socket} = state) when kind in [:tcp, :ssl],
    do: {:noreply, handle_buffer(%{state | buffer: state.buffer <> data})}

  def handle_info({kind, socket}, %{socket: socket} = state)
      when kind in [:tcp_closed, :ssl_closed],
      do: {:noreply, handle_disconnect(state)}

  def handle_info({kind, socket, _reason}, %{socket: socket} = state)
      when kind in [:tcp_error, :ssl_error],
      do: {:noreply, handle_disconnect(state)}

  def handle_info({:late, id}, state) do
    {entry, pending} = Map.pop(state.pending, id)
    with {from, _timer} <- entry, do: GenServer.reply(from, {:error, :timeout})
    {:noreply, %{state | pending: pending}}
  end

  def handle_info(:connect, %{socket: nil} = state) do
    case connect_next(state) do
      {:ok, state} ->
        {:noreply, log_connected(state)}

      {:error, error} ->
        Process.send_after(self(), :connect, @retry_ms)
        state = next_server(state)

        {:noreply,
         if(hd(state.servers) == state.first_server, do: warn_waiting(state, error), else: state)}
    end
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp handle_buffer(state) do
    case Protocol.parse_frame(state.buffer, max_frame_size(state.info)) do
      :more -> activate_socket(state)
      {:ok, frame, rest} -> frame |> handle_frame(%{state | buffer: rest}) |> handle_rest()
      {:error, _why} -> handle_disconnect(state)
    end
  end

  defp handle_rest(%{socket: nil} = state), do: state
  defp handle_rest(state), do: handle_buffer(state)

  defp activate_socket(state) do
    case set_active_once(state) do
      :ok -> state
      {:error, _} -> handle_disconnect(state)
    end
  end

  defp set_active_once(%{transport: :gen_tcp, socket: socket}),
    do: :inet.setopts(socket, active: :once)

  defp set_active_once(%{transport: :ssl, socket: socket}),
    do: :ssl.setopts(socket, active: :once)

  defp handle_frame(:ping, state) do
    case state.transport.send(state.socket, "PONG\r\n") do
      :ok -> state
      {:error, _} -> handle_disconnect(state)
    end
  end

  defp handle_frame({:message, message}, state) do
    if String.starts_with?(message.subject, state.inbox),
      do: reply_to_request(message, state),
      else: notify_subscriber(state, message)
  end

  # The server sends this again when a server joins the cluster or when its limits change.
  defp handle_frame({:info, json}, state) do
    case JSON.decode(json) do
      {:ok, info} when is_map(info) -> %{state | info: info}
      _ -> state
    end
  end

  # After most of these errors the server closes the connection.
  defp handle_frame({:failure, _text}, state), do: state
  defp handle_frame(_frame, state), do: state

  defp notify_subscriber(state, event) do
    with pid when pid != nil <- state.opts[:subscriber], do: send(pid, {:nats, self(), event})
    state
  end

  defp reply_to_request(message, state) do
    id = message.subject |> String.split(".") |> List.last() |> Integer.parse()

    with {id, ""} <- id, {{from, timer}, pending} <- Map.pop(state.pending, id) do
      Process.cancel_timer(timer)
      GenServer.reply(from, {:ok, message})
      %{state | pending: pending}
    else
      _ -> state
    end
  end

  defp handle_disconnect(%{socket: nil} = state), do: state

  defp handle_disconnect(state) do
    state.transport.close(state.socket)

    for {_, {from, timer}} <- state.pending do
      Process.cancel_timer(timer)
      GenServer.reply(from, {:error, :down})
    end

    send(self(), :connect)
    next_server(%{state | socket: nil, info: nil, buffer: "", pending: %{}})
  end

  # The following functions connect.

  defp connect_next(%{servers: [server | _]} = state) do
    with {:ok, dialed} <- Dialer.connect(server, state.opts) do
      %{transport: transport, socket: socket, inbox: inbox, info: info, rest: rest} = dialed
      state = %{state | transport: transport, socket: socket, inbox: inbox, info: info}
      {:ok, %{state | buffer: rest} |> notify_subscriber(:up) |> handle_buffer()}
    end
  end

  defp max_frame_size(info),
    do: Map.get(info || %{}, "max_payload", 1_048_576) * 2 + @header_space

  defp server_name(%{servers: [server | _]}), do: Dialer.format_server(server)

  # Keeps passwords out of crash logs.
  @impl true
  def format_status(_reason, [_dictionary, state]),
    do: [data: [{~c"State", %{servers: state.servers, connected: state.socket != nil}}]]
end
