defmodule Situ.Live.Channel do
  @moduledoc false
  # The connection of one page. It speaks version 2 of the Phoenix Channels protocol over one WebSocket, with messages
  # `[join_ref, ref, topic, event, payload]`. Each view runs in a separate process. This process routes and counts
  # messages, and replies on behalf of views that have ended.
  @behaviour Situ.Live.SocketHandler
  alias Situ.JSON
  alias Situ.Live.{Endpoint, ViewLifecycle, Token, ViewServer}

  @session_age_s 14 * 86_400
  # A user cannot cause this many pending messages, so the connection is closed.
  @max_pending 500
  @max_topics 20

  defstruct [:config, :parameters, topics: %{}, monitors: %{}, pending: 0]

  @impl true
  def init(request, config) do
    case Endpoint.fetch_config(config.ref) do
      {:ok, config} ->
        Process.monitor(views_supervisor(config))
        {:ok, %__MODULE__{config: config, parameters: ViewServer.connect_params(request)}}

      :error ->
        {:error, "the server has stopped"}
    end
  end

  defp views_supervisor(config), do: GenServer.whereis(ViewServer.supervisor_name(config.ref))

  @impl true
  def handle_in({text, opcode: :text}, state) do
    case JSON.decode(text) do
      {:ok, [join_ref, ref, topic, event, payload]}
      when (is_binary(join_ref) or join_ref == nil) and (is_binary(ref) or ref == nil) and
             is_binary(topic) and is_binary(event) ->
        handle_message({join_ref, ref, topic, event}, payload, state)

      _ ->
        {:stop, {1007, "not a message of this protocol"}, state}
    end
  end

  # Uploads use HTTP, so no message of the protocol is binary.
  def handle_in({_, opcode: :binary}, state), do: {:stop, {1003, "text only"}, state}

  defp handle_message({_, ref, "phoenix", "heartbeat"}, _, state),
    do: {:push, encode_reply(nil, ref, "phoenix", "ok", %{}), state}

  defp handle_message(_, payload, state) when not is_map(payload) and payload != nil,
    do: {:stop, {1007, "not a message of this protocol"}, state}

  defp handle_message({join_ref, ref, "lv:" <> id = topic, "phx_join"}, payload, state) do
    state = drop_topic(topic, state)

    with true <- map_size(state.topics) < @max_topics || "too many views",
         {:ok, %{"id" => ^id, "view" => view, "session" => session}} <-
           verify_session(state, payload["session"]),
         url = payload["url"] || payload["redirect"],
         {:ok, route, params} <- ViewLifecycle.fetch_route(state.config, url),
         true <- ViewLifecycle.session_scope(route) == view || "stale" do
      start_view(
        %{id: id, topic: topic, join_ref: join_ref, ref: ref, uri: url, session: session},
        route,
        params,
        state
      )
    else
      reason when is_binary(reason) ->
        {:push, encode_reply(join_ref, ref, topic, "error", %{"reason" => reason}), state}

      # The page must be reloaded: its token is too old or invalid, or its address does not lead to a view.
      _ ->
        {:push, encode_reply(join_ref, ref, topic, "error", %{"reason" => "stale"}), state}
    end
  end

  defp handle_message({join_ref, ref, topic, event}, payload, state) do
    case state.topics do
      %{^topic => {pid, ^join_ref, _}} when state.pending < @max_pending ->
        send(pid, {:situ_live, ref, event, payload})
        {:ok, %{state | pending: state.pending + 1}}

      %{^topic => {_, ^join_ref, _}} ->
        {:stop, {1008, "too many messages"}, state}

      _ when event == "phx_leave" ->
        {:push, encode_reply(join_ref, ref, topic, "ok", %{}), state}

      _ ->
        {:push, encode_reply(join_ref, ref, topic, "error", %{"reason" => "unmatched topic"}),
         state}
    end
  end

  defp verify_session(state, token),
    do: Token.verify(state.config.secret, "session", token, @session_age_s)

  defp start_view(join, route, params, state) do
    join =
      Map.merge(join, %{
        config: state.config,
        route: route,
        params: params,
        transport: self(),
        parameters: state.parameters
      })

    {:ok, pid} = ViewServer.start_view(state.config, join)
    monitor = Process.monitor(pid)
    topics = Map.put(state.topics, join.topic, {pid, join.join_ref, monitor})
    monitors = Map.put(state.monitors, monitor, {join.topic, join.join_ref})
    {:ok, %{state | topics: topics, monitors: monitors, pending: state.pending + 1}}
  end

  @impl true
  def handle_info({:situ_live, topic, ref, text}, state) do
    pending = if ref == nil, do: state.pending, else: max(state.pending - 1, 0)
    state = %{state | pending: pending}
    # Nothing receives messages of a view that the page has left.
    if is_map_key(state.topics, topic), do: {:push, {:text, text}, state}, else: {:ok, state}
  end

  def handle_info({:DOWN, monitor, _, _, reason}, state) do
    case Map.pop(state.monitors, monitor) do
      {{topic, join_ref}, monitors} ->
        event = if crash_reason?(reason), do: "phx_error", else: "phx_close"
        text = JSON.encode([join_ref, join_ref, topic, event, %{}])
        state = %{state | monitors: monitors, topics: Map.delete(state.topics, topic), pending: 0}
        {:push, {:text, text}, state}

      # If the supervisor of the views has ended, the server has stopped.
      {nil, _} ->
        if views_supervisor(state.config) == nil,
          do: {:stop, {1001, "the server has stopped"}, state},
          else: {:ok, state}
    end
  end

  def handle_info(_, state), do: {:ok, state}

  defp crash_reason?({:shutdown, :crashed}), do: true
  defp crash_reason?({:shutdown, _}), do: false
  defp crash_reason?(reason), do: reason not in [:normal, :shutdown]

  # A join replaces the view that was joined under the same topic.
  defp drop_topic(topic, state) do
    case Map.pop(state.topics, topic) do
      {nil, _} ->
        state

      {{pid, _, monitor}, topics} ->
        Process.demonitor(monitor, [:flush])
        Process.exit(pid, :shutdown)
        %{state | topics: topics, monitors: Map.delete(state.monitors, monitor)}
    end
  end

  defp encode_reply(join_ref, ref, topic, status, response) do
    payload = %{"status" => status, "response" => response}
    {:text, JSON.encode([join_ref, ref, topic, "phx_reply", payload])}
  end
end
