defmodule Situ.Link.Server.Session do
  @moduledoc false
  # Handles the session of one client. The client authenticates, receives the catalogue, subscribes to streams, and
  # is sent messages as its credit allows. Its data can affect only its own session; invalid data end the connection
  # with an error.
  use GenServer, restart: :temporary
  alias Situ.Error
  alias Situ.Link.Wire.{Frame, Handshake, Schedule, Socket}
  alias Situ.Link.Server.{Channel, RecordingReader, Requests, Sender, ServedRecordings}
  alias Situ.Store.Query
  require Logger

  @login_ms 10_000
  @check_ms 500
  # The frame limit after the login. Subscriptions and requests are short.
  @max_frame 1024 * 1024
  @max_channels 100_000
  # Smaller tags are versions of recordings.
  @first_tag 0x100000000

  defstruct [
    :server,
    :config,
    :socket,
    :nonce,
    :peer,
    :reader,
    :client_nonce,
    stage: :greeting,
    channels: %{},
    announced: %{},
    schedule: Schedule.new(),
    stores: %{},
    replies: :queue.new(),
    reading_paused?: false,
    sending_paused?: false,
    send_scheduled?: false,
    sent: 0,
    messages: 0
  ]

  @type t :: %__MODULE__{}

  def start_link(config), do: GenServer.start_link(__MODULE__, config)

  @doc "Passes an accepted connection to the session. The caller must be its owner."
  @spec adopt_socket(pid(), Socket.t()) :: :ok | {:error, term()}
  def adopt_socket(session, socket) do
    with :ok <- Socket.set_owner(socket, session) do
      send(session, {:adopt, socket})
      :ok
    end
  end

  @impl true
  def init(config), do: {:ok, %__MODULE__{config: config, server: config.server}}

  @impl true
  def handle_info({:adopt, socket}, state) do
    with {:ok, socket} <- Socket.complete_handshake(socket, @login_ms),
         nonce = Handshake.new_nonce(),
         :ok <- Socket.send(socket, Frame.encode(Handshake.build_hello(nonce))),
         :ok <- Socket.activate_once(socket) do
      Process.send_after(self(), :login_late, @login_ms)
      {:noreply, %{state | socket: socket, nonce: nonce}}
    else
      {:error, reason} -> {:stop, {:shutdown, reason}, state}
    end
  end

  def handle_info({kind, _socket, body}, state) when kind in [:tcp, :ssl] do
    case Frame.decode(body) do
      {:ok, frame} -> frame |> handle_frame(state) |> after_frame(state)
      {:error, why} -> refuse_client(bad_frame(why), state)
    end
  end

  def handle_info({kind, _socket}, state) when kind in [:tcp_closed, :ssl_closed],
    do: {:stop, {:shutdown, :closed}, state}

  def handle_info({kind, _socket, reason}, state) when kind in [:tcp_error, :ssl_error] do
    if reason == :emsgsize, do: log_warning(state, "a frame exceeds the size limit"), else: :ok
    {:stop, {:shutdown, reason}, state}
  end

  def handle_info(:login_late, %{stage: :open} = state), do: {:noreply, state}
  def handle_info(:login_late, state), do: refuse_client(bad_frame("no login within 10 s"), state)
  def handle_info(:resume, state), do: send_pending(%{state | sending_paused?: false})
  def handle_info(:send, state), do: send_pending(%{state | send_scheduled?: false})

  def handle_info(:check, state) do
    Process.send_after(self(), :check, @check_ms)

    case RecordingReader.check_versions(state.reader) do
      {true, reader} -> handle_new_data(%{state | reader: reader})
      {false, reader} -> {:noreply, %{state | reader: reader}}
    end
  end

  def handle_info({:situ_sent, id, bytes}, state) do
    case state.channels do
      %{^id => channel} -> send_pending(add_credit(state, channel, bytes))
      _ -> {:noreply, state}
    end
  end

  # A client awaits this notice. The tag contains the id of its request.
  def handle_info({:situ_store, tag, notice}, state) when tag >= @first_tag,
    do:
      {:noreply, queue_reply(state, tag - @first_tag, Requests.term_reply(notice))}
      |> then_send_pending()

  def handle_info(message, %{stage: :open} = state) do
    case RecordingReader.handle_notice(state.reader, message) do
      {:ok, reader} -> handle_new_data(%{state | reader: reader})
      :other -> {:noreply, state}
    end
  end

  def handle_info(_other, state), do: {:noreply, state}

  @impl true
  def handle_call(:drained?, _from, state), do: {:reply, Sender.drained?(state), state}

  # All data were sent, and the client closes the connection after reading them. Closing it here could discard data in
  # flight.
  def handle_call(:finish, _from, state) do
    if state.socket, do: Socket.finish_sending(state.socket)
    {:reply, :ok, %{state | sending_paused?: true}}
  end

  def handle_call(:info, _from, state), do: {:reply, session_stats(state), state}

  defp session_stats(state) do
    %{
      peer: state.peer,
      channels: map_size(state.channels),
      bytes: state.sent,
      messages: state.messages,
      dropped: state.channels |> Map.values() |> Enum.map(& &1.dropped) |> Enum.sum()
    }
  end

  # The following clauses handle frames from the client.

  defp handle_frame({:hello, version, oldest, nonce}, %{stage: :greeting} = state) do
    with {:ok, _version} <- Handshake.check_version(version, oldest),
         do: {:ok, %{state | stage: :login, client_nonce: nonce}}
  end

  # The server is full. The client gets the reason after its login, when it expects a reply.
  defp handle_frame({:login, _proof, _map}, %{stage: :login, config: %{refusal: error}}),
    do: {:error, error}

  defp handle_frame({:login, proof, map}, %{stage: :login} = state) do
    if Handshake.valid_proof?(
         state.config.token,
         :client,
         state.nonce,
         state.client_nonce,
         proof
       ),
       do: log_in(map, state),
       else: {:error, wrong_token()}
  end

  defp handle_frame({:ping, t0}, %{stage: :open} = state) do
    t1 = state.config.now.()
    send_frame(state, {:pong, t0, t1, state.config.now.()})
  end

  defp handle_frame({:credit, id, bytes}, %{stage: :open} = state) do
    case state.channels do
      # Datagrams are credited when they are sent (`:situ_sent`), because lost ones are never consumed.
      %{^id => %{datagrams: nil} = channel} -> {:send, add_credit(state, channel, bytes)}
      # The stream has ended since.
      _ -> {:ok, state}
    end
  end

  defp handle_frame({:subscribe, id, map}, %{stage: :open} = state)
       when map_size(state.channels) < @max_channels do
    with {:new, true} <- {:new, not is_map_key(state.channels, id)},
         {:ok, channel} <- Channel.new(id, map) do
      state = Sender.open_channel(%{state | channels: Map.put(state.channels, id, channel)}, id)
      {:send, state}
    else
      {:new, false} -> {:error, bad_frame("channel #{id} is in use")}
      {:error, why} -> {:error, bad_frame(why)}
    end
  end

  defp handle_frame({:request, id, map}, %{stage: :open} = state) do
    with {:ok, store, state} <- fetch_store(state, map["version"]) do
      case Requests.handle_request(store, map) do
        {:ok, parts} -> {:send, queue_reply(state, id, parts)}
        {:await, known} -> {Query.notify(store, known, @first_tag + id), state}
      end
    else
      {:error, %Error{} = error} -> {:send, queue_reply(state, id, Requests.error_reply(error))}
    end
  end

  defp handle_frame({:unsubscribe, id}, %{stage: :open} = state) do
    {channel, channels} = Map.pop(state.channels, id)
    if channel && channel.datagrams, do: GenServer.stop(channel.datagrams)
    {:ok, %{state | channels: channels}}
  end

  defp handle_frame(frame, state),
    do: {:error, bad_frame("unexpected frame: #{elem(frame, 0)} (in stage #{state.stage})")}

  # The client only asks for the names of the recordings.
  defp log_in(%{"list" => true}, state) do
    with {:ok, _state} <- send_frame(state, welcome_frame(state)) do
      Socket.finish_sending(state.socket)
      {:error, :listed}
    end
  end

  defp log_in(map, state) do
    name = map["name"] || ""

    with {:ok, spec} <- ServedRecordings.fetch_recording(state.config.served, name),
         {:ok, reader} <- RecordingReader.open(spec) do
      send(self(), :check)
      state = %{state | stage: :open, reader: reader, peer: peer_address(state)}

      with {:ok, state} <- send_frame(state, welcome_frame(state)),
           :ok <- Socket.enable_frames(state.socket, @max_frame),
           do: {:send, announce_streams(state)}
    end
  end

  defp welcome_frame(state) do
    proof = Handshake.build_proof(state.config.token, :server, state.nonce, state.client_nonce)
    {:welcome, proof, %{"names" => Map.keys(state.config.served)}}
  end

  defp peer_address(state) do
    case Socket.peer_address(state.socket) do
      {:ok, peer} -> peer
      {:error, _} -> nil
    end
  end

  # A client keeps the version that it opened, even if a newer one was recorded since.
  defp fetch_store(state, nil) do
    with {:ok, store} <- RecordingReader.fetch_store(state.reader, nil), do: {:ok, store, state}
  end

  defp fetch_store(state, version) do
    with :error <- Map.fetch(state.stores, version),
         {:ok, store} <- RecordingReader.fetch_store(state.reader, version) do
      {:ok, store, %{state | stores: Map.put(state.stores, version, store)}}
    else
      {:ok, store} -> {:ok, store, state}
      {:error, error} -> {:error, error}
    end
  end

  defp queue_reply(state, id, parts) do
    queue = for part <- parts, reduce: state.replies, do: (queue -> :queue.in({id, part}, queue))
    %{state | replies: queue}
  end

  # Returns the state after a frame of the client.

  defp after_frame({:ok, state}, _before), do: activate_socket(state)

  # Further requests of a client are not handled until it has read its replies.
  defp after_frame({:send, state}, _before) do
    if :queue.is_empty(state.replies),
      do: state |> activate_socket() |> then_send_pending(),
      else: send_pending(%{state | reading_paused?: true})
  end

  defp after_frame({:error, %Error{} = error}, state), do: refuse_client(error, state)
  defp after_frame({:error, reason}, state), do: {:stop, {:shutdown, reason}, state}

  defp activate_socket(state) do
    case Socket.activate_once(state.socket) do
      :ok -> {:noreply, state}
      {:error, reason} -> {:stop, {:shutdown, reason}, state}
    end
  end

  defp then_send_pending({:noreply, state}), do: send_pending(state)
  defp then_send_pending(stop), do: stop

  defp handle_new_data(state) do
    state |> announce_streams() |> Sender.schedule_all() |> send_pending()
  end

  defp announce_streams(state) do
    case RecordingReader.list_streams(state.reader) do
      {:same, reader} ->
        %{state | reader: reader}

      {entries, reader} ->
        added = for entry <- entries, state.announced[entry.name] != entry.type, do: entry
        announced = Map.merge(state.announced, Map.new(added, &{&1.name, &1.type}))
        send_streams(state, added)
        Sender.open_waiting(%{state | reader: reader, announced: announced})
    end
  end

  # An empty list is sent, too, because the client waits for the first list.
  defp send_streams(state, added) do
    streams = for entry <- added, do: %{"name" => entry.name, "type" => entry.type}
    _ = Socket.send(state.socket, Frame.encode({:streams, %{"streams" => streams}}))
  end

  defp send_pending(%{sending_paused?: true} = state), do: {:noreply, state}
  defp send_pending(%{stage: stage} = state) when stage != :open, do: {:noreply, state}

  defp send_pending(state) do
    case Sender.send_replies(state) do
      {:sent, %{reading_paused?: true} = state} ->
        %{state | reading_paused?: false} |> activate_socket() |> then_send_pending()

      {:sent, state} ->
        send_stream_frames(state)

      {:wait, ns, state} ->
        {:noreply, pause_sending(state, ns)}

      {:error, reason, state} ->
        {:stop, {:shutdown, reason}, state}
    end
  end

  defp send_stream_frames(state) do
    case Sender.send_frames(state) do
      {:more, state} -> {:noreply, schedule_send(state)}
      {:wait, ns, state} -> {:noreply, pause_sending(state, ns)}
      {:idle, state} -> {:noreply, state}
      {:error, reason, state} -> {:stop, {:shutdown, reason}, state}
    end
  end

  defp schedule_send(%{send_scheduled?: true} = state), do: state

  defp schedule_send(state) do
    send(self(), :send)
    %{state | send_scheduled?: true}
  end

  defp pause_sending(state, ns) do
    Process.send_after(self(), :resume, max(div(ns, 1_000_000), 1))
    %{state | sending_paused?: true}
  end

  defp add_credit(state, channel, bytes),
    do: Sender.put_channel(state, %{channel | credit: channel.credit + bytes})

  defp send_frame(state, frame) do
    with :ok <- Socket.send(state.socket, Frame.encode(frame)), do: {:ok, state}
  end

  # The client receives the reason before the connection ends. The server limits how often it may try again.
  defp refuse_client(error, state) do
    log_warning(state, Exception.message(error))
    send(state.server, {:refused, self(), error.code})
    _ = Socket.send(state.socket, Frame.encode({:refused, Handshake.error_to_map(error)}))
    Socket.close(state.socket)
    {:stop, {:shutdown, error.code}, state}
  end

  defp log_warning(state, text),
    do: Logger.warning("link from #{inspect(peer_address(state))}: #{text}")

  defp wrong_token do
    Error.new(:wrong_token, "the token of the link is wrong",
      why: "the client could not prove that it knows the token",
      fix: "give both sides the same `token:`"
    )
  end

  defp bad_frame(why) do
    Error.new(:bad_frame, "the other side violated the link protocol", why: why)
  end
end
