defmodule Situ.Live.ViewServer do
  @moduledoc false
  # The process of one joined view, under its server's view supervisor. It ends together with the connection that
  # started it. It encodes messages for the browser itself, so that one large page does not delay the connection's
  # other topics.
  #
  # From the connection: {:situ_live, ref, event, payload}. To it: {:situ_live, topic, ref | nil, text}, where `ref` is
  # set in the reply to a message and equals that message's `ref`.
  use GenServer, restart: :temporary
  require Logger
  alias Situ.JSON
  alias Situ.Live.{Diff, Endpoint, DiffPacing, ViewLifecycle, PublicAddress, Socket, View}

  @version "1.2.12"
  @stale_ms 60_000

  defstruct [
    :config,
    :socket,
    :route,
    :transport,
    :topic,
    :join_ref,
    :timer,
    session: %{},
    memory: %Diff{},
    flow: %DiffPacing{},
    dirty?: false
  ]

  def start_link(join), do: GenServer.start_link(__MODULE__, join, hibernate_after: @stale_ms)

  @impl true
  def init(join) do
    Process.monitor(join.transport)
    {:ok, join, {:continue, :join}}
  end

  @impl true
  def handle_continue(:join, join) do
    state = %__MODULE__{
      config: join.config,
      route: join.route,
      transport: join.transport,
      topic: join.topic,
      join_ref: join.join_ref,
      session: join.session,
      flow: DiffPacing.new(Map.put(join.config.flow, :ack?, join.parameters["situ_flow"] != nil))
    }

    socket = %Socket{
      id: join.id,
      endpoint: join.config.ref,
      connected?: true
    }

    join_view(state, socket, join)
  end

  defp join_view(state, socket, join) do
    socket = ViewLifecycle.mount_view(join.route, join.params, join.session, join.uri, socket)

    case socket.navigation do
      {kind, target} when kind in [:redirect, :live_redirect] ->
        send_reply(state, join.ref, "error", %{kind => to_public_path(state, target)})
        {:stop, :normal, state}

      navigation ->
        state = %{state | socket: socket}
        {diff, state} = take_diff(state, :all)
        response = %{"rendered" => diff, "liveview_version" => @version}
        send_reply(state, join.ref, "ok", put_live_patch(state, response, navigation))
        follow_navigation(state, navigation)
    end
  catch
    kind, reason ->
      log_crash(kind, reason, __STACKTRACE__)
      send_reply(state, join.ref, "error", %{"reason" => "join crashed"})
      {:stop, {:shutdown, :crashed}, state}
  end

  defp put_live_patch(state, response, {:live_patch, target}),
    do: Map.put(response, "live_patch", to_public_path(state, target))

  defp put_live_patch(_state, response, nil), do: response

  # Converts to the path that the browser uses: a proxy may add a prefix.
  defp to_public_path(state, %{"to" => "/" <> _ = to} = target),
    do: %{target | "to" => PublicAddress.base_path(state.config.public) <> to}

  defp to_public_path(_state, target), do: target

  # -- from the browser

  @impl true
  def handle_info({:DOWN, _, _, transport, _}, %{transport: transport} = state),
    do: {:stop, :normal, state}

  def handle_info({:situ_live, ref, event, payload}, state),
    do: with_crash_guard(state, &handle_message(event, payload, ref, &1))

  def handle_info(:situ_live_render, state) do
    state = %{state | timer: nil}
    if state.dirty?, do: with_crash_guard(state, &push_diff/1), else: {:noreply, state}
  end

  def handle_info(message, state) do
    with_crash_guard(state, fn state ->
      handle_change(%{
        state
        | socket: View.call_handle_info(state.socket.view, message, state.socket)
      })
    end)
  end

  defp handle_message("event", %{"event" => "situ:ack"}, ref, state) do
    send_reply(state, ref, "ok", %{})
    state = %{state | flow: DiffPacing.record_ack(state.flow)}
    if state.dirty?, do: push_diff(state), else: {:noreply, state}
  end

  defp handle_message("event", %{"event" => name, "type" => type} = payload, ref, state)
       when is_binary(name) do
    case ViewLifecycle.event_params(type, payload["value"], payload["meta"]) do
      {:ok, params} ->
        reply_with_diff(
          %{
            state
            | socket: View.call_handle_event(state.socket.view, name, params, state.socket)
          },
          ref
        )

      :error ->
        reply_malformed(state, ref)
    end
  end

  # The browser may patch only to addresses of this view. For any other address it must load the page.
  defp handle_message("live_patch", %{"url" => url}, ref, state) do
    case ViewLifecycle.fetch_route(state.config, url) do
      {:ok, %{target: view} = route, params} when view == state.socket.view ->
        reply_with_diff(
          %{state | route: route, socket: patch_socket(state, route, params, url)},
          ref
        )

      _ ->
        send_reply(state, ref, "ok", %{"link_redirect" => true})
        {:noreply, state}
    end
  end

  defp handle_message("cids_will_destroy", _, ref, state) do
    send_reply(state, ref, "ok", %{})
    {:noreply, state}
  end

  defp handle_message("cids_destroyed", %{"cids" => cids}, ref, state) when is_list(cids) do
    send_reply(state, ref, "ok", %{"cids" => cids -- Diff.visible_cids(state.memory, cids)})
    {:noreply, state}
  end

  defp handle_message("phx_leave", _, ref, state) do
    send_reply(state, ref, "ok", %{})
    {:stop, :normal, state}
  end

  defp handle_message(_, _, ref, state), do: reply_malformed(state, ref)

  defp reply_malformed(state, ref) do
    send_reply(state, ref, "error", %{"reason" => "malformed message"})
    {:noreply, state}
  end

  defp patch_socket(state, route, params, url) do
    socket = Socket.assign(state.socket, :live_action, route.opts[:action])
    View.call_handle_params(socket.view, params, url, socket)
  end

  # -- to the browser

  defp reply_with_diff(state, ref) do
    navigation = state.socket.navigation
    {diff, state} = take_diff(state, :changed)
    send_reply(state, ref, "ok", if(diff == %{}, do: %{}, else: %{"diff" => diff}))
    follow_navigation(%{state | dirty?: false}, navigation)
  end

  # A navigation is sent immediately, because the browser is about to leave the page.
  defp handle_change(%{socket: %{navigation: nil}} = state), do: push_diff(state)

  defp handle_change(state) do
    navigation = state.socket.navigation
    follow_navigation(send_diff(state), navigation)
  end

  defp push_diff(state) do
    case DiffPacing.time_to_send(state.flow, current_ms()) do
      :now -> {:noreply, send_diff(state)}
      {:wait, ms} -> {:noreply, %{schedule_render(state, ms) | dirty?: true}}
    end
  end

  defp schedule_render(%{timer: nil} = state, ms),
    do: %{state | timer: Process.send_after(self(), :situ_live_render, ms)}

  # A timer is already running; when it fires, the remaining time is computed again.
  defp schedule_render(state, _ms), do: state

  defp send_diff(state) do
    {diff, state} = take_diff(state, :changed)
    state = %{state | dirty?: false}

    if diff == %{} do
      state
    else
      diff =
        if state.flow.ack?,
          do: Map.update(diff, "e", [ack_event()], &(&1 ++ [ack_event()])),
          else: diff

      send_message(state, nil, [state.join_ref, nil, state.topic, "diff", diff])
      %{state | flow: DiffPacing.record_sent(state.flow, current_ms())}
    end
  end

  defp ack_event, do: ["situ:ack", %{}]

  defp take_diff(%{socket: socket} = state, scope) do
    {diff, memory} = diff_tree(socket, state.memory, scope)

    diff =
      diff
      |> put_if("e", socket.events != [], fn -> Enum.reverse(socket.events) end)
      |> put_if("r", socket.reply != nil, fn -> socket.reply end)
      |> put_if("t", title_changed?(socket, scope), fn -> socket.assigns.page_title end)

    {diff, %{state | socket: Socket.__clear_message__(socket), memory: memory}}
  end

  defp diff_tree(%{assigns: %{__changed__: changed}}, memory, :changed) when changed == %{},
    do: {%{}, memory}

  defp diff_tree(socket, memory, scope) do
    case Diff.diff_tree(ViewLifecycle.render_view(socket, scope), memory) do
      :stale -> Diff.diff_tree(ViewLifecycle.render_view(socket, :all), memory)
      result -> result
    end
  end

  defp title_changed?(%{assigns: %{page_title: title} = assigns}, scope) when is_binary(title),
    do: scope == :all or is_map_key(assigns.__changed__, :page_title)

  defp title_changed?(_, _), do: false

  defp put_if(diff, key, true, value), do: Map.put(diff, key, value.())
  defp put_if(diff, _, false, _), do: diff

  defp follow_navigation(state, nil), do: {:noreply, state}

  defp follow_navigation(state, {:live_patch, %{"to" => to} = target}) do
    public_target = to_public_path(state, target)
    send_message(state, nil, [state.join_ref, nil, state.topic, "live_patch", public_target])

    case ViewLifecycle.fetch_route(state.config, to) do
      {:ok, %{target: view} = route, params} when view == state.socket.view ->
        handle_change(%{state | route: route, socket: patch_socket(state, route, params, to)})

      _ ->
        raise ArgumentError,
              "invalid push_patch to #{inspect(to)}: this is not a page of #{inspect(state.socket.view)}"
    end
  end

  defp follow_navigation(state, {kind, target}) do
    public_target = to_public_path(state, target)

    send_message(state, nil, [
      state.join_ref,
      nil,
      state.topic,
      Atom.to_string(kind),
      public_target
    ])

    {:noreply, state}
  end

  defp send_reply(state, ref, status, response) do
    payload = %{"status" => status, "response" => response}
    send_message(state, ref, [state.join_ref, ref, state.topic, "phx_reply", payload])
  end

  defp send_message(state, ref, message) do
    send(state.transport, {:situ_live, state.topic, ref, JSON.encode(message)})
    :ok
  end

  # An exception ends the process with a reason that contains no assigns, because crash reports may be read by others.
  defp with_crash_guard(state, fun) do
    fun.(state)
  catch
    kind, reason ->
      log_crash(kind, reason, __STACKTRACE__)
      {:stop, {:shutdown, :crashed}, state}
  end

  defp log_crash(kind, reason, stack), do: Logger.error(Exception.format(kind, reason, stack))

  defp current_ms, do: System.monotonic_time(:millisecond)

  @impl true
  def terminate(reason, %__MODULE__{socket: %Socket{view: view} = socket}) do
    if function_exported?(view, :terminate, 2), do: view.terminate(reason, socket)
  end

  def terminate(_, _), do: :ok

  @impl true
  def format_status(_reason, [_dictionary, _state]), do: [data: [{~c"State", :hidden}]]

  @doc false
  def supervisor_name(ref), do: {:via, Registry, {Situ.Live.Registry, {ref, :views}}}

  @doc false
  @spec start_view(Endpoint.t(), map()) :: DynamicSupervisor.on_start_child()
  def start_view(config, join),
    do: DynamicSupervisor.start_child(supervisor_name(config.ref), {__MODULE__, join})

  @doc false
  def connect_params(request), do: Map.drop(request.query, ["vsn", "token"])
end
