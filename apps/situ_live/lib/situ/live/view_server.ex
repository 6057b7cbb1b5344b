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
  alias Situ.Live.{Diff, Endpoint, Flow, Page, Public, Socket, View}

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
    flow: %Flow{},
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
      flow: Flow.new(Map.put(join.config.flow, :ack?, join.parameters["situ_flow"] != nil))
    }

    socket = %Socket{
      id: join.id,
      endpoint: join.config.ref,
      connected?: true,
      parameters: join.parameters
    }

    join(state, socket, join)
  end

  defp join(state, socket, join) do
    socket = Page.mount(join.route, join.params, join.session, join.uri, socket)

    case socket.navigation do
      {kind, target} when kind in [:redirect, :live_redirect] ->
        reply(state, join.ref, "error", %{kind => outward(state, target)})
        {:stop, :normal, state}

      navigation ->
        state = %{state | socket: socket}
        {diff, state} = diff(state, :all)
        response = %{"rendered" => diff, "liveview_version" => @version}
        reply(state, join.ref, "ok", patched(state, response, navigation))
        follow(state, navigation)
    end
  catch
    kind, reason ->
      log(kind, reason, __STACKTRACE__)
      reply(state, join.ref, "error", %{"reason" => "join crashed"})
      {:stop, {:shutdown, :crashed}, state}
  end

  defp patched(state, response, {:live_patch, target}),
    do: Map.put(response, "live_patch", outward(state, target))

  defp patched(_state, response, nil), do: response

  # Converts to the path that the browser uses: a proxy may add a prefix.
  defp outward(state, %{"to" => "/" <> _ = to} = target),
    do: %{target | "to" => Public.base(state.config.public) <> to}

  defp outward(_state, target), do: target

  # -- from the browser

  @impl true
  def handle_info({:DOWN, _, _, transport, _}, %{transport: transport} = state),
    do: {:stop, :normal, state}

  def handle_info({:situ_live, ref, event, payload}, state),
    do: guard(state, &message(event, payload, ref, &1))

  def handle_info(:situ_live_render, state) do
    state = %{state | timer: nil}
    if state.dirty?, do: guard(state, &push/1), else: {:noreply, state}
  end

  def handle_info(message, state) do
    guard(state, fn state ->
      changed(%{state | socket: View.info(state.socket.view, message, state.socket)})
    end)
  end

  defp message("event", %{"event" => "situ:ack"}, ref, state) do
    reply(state, ref, "ok", %{})
    state = %{state | flow: Flow.acknowledged(state.flow)}
    if state.dirty?, do: push(state), else: {:noreply, state}
  end

  defp message("event", %{"event" => name, "type" => type} = payload, ref, state)
       when is_binary(name) do
    case Page.event_params(type, payload["value"], payload["meta"]) do
      {:ok, params} ->
        answer(%{state | socket: View.event(state.socket.view, name, params, state.socket)}, ref)

      :error ->
        malformed(state, ref)
    end
  end

  # The browser patches only within the page that it takes for this view; if the route differs, it must load the page.
  defp message("live_patch", %{"url" => url}, ref, state) do
    case Page.find(state.config, url) do
      {:ok, %{target: view} = route, params} when view == state.socket.view ->
        answer(%{state | route: route, socket: patch(state, route, params, url)}, ref)

      _ ->
        reply(state, ref, "ok", %{"link_redirect" => true})
        {:noreply, state}
    end
  end

  defp message("cids_will_destroy", _, ref, state) do
    reply(state, ref, "ok", %{})
    {:noreply, state}
  end

  defp message("cids_destroyed", %{"cids" => cids}, ref, state) when is_list(cids) do
    reply(state, ref, "ok", %{"cids" => cids -- Diff.present(state.memory, cids)})
    {:noreply, state}
  end

  defp message("phx_leave", _, ref, state) do
    reply(state, ref, "ok", %{})
    {:stop, :normal, state}
  end

  defp message(_, _, ref, state), do: malformed(state, ref)

  defp malformed(state, ref) do
    reply(state, ref, "error", %{"reason" => "malformed message"})
    {:noreply, state}
  end

  defp patch(state, route, params, url) do
    socket =
      state.socket
      |> Socket.assign(:live_action, route.opts[:action])
      |> Socket.clear_flash()

    View.params(socket.view, params, url, socket)
  end

  # -- to the browser

  defp answer(state, ref) do
    navigation = state.socket.navigation
    {diff, state} = diff(state, :changed)
    reply(state, ref, "ok", if(diff == %{}, do: %{}, else: %{"diff" => diff}))
    follow(%{state | dirty?: false}, navigation)
  end

  # A navigation is sent immediately, because the browser is about to leave the page.
  defp changed(%{socket: %{navigation: nil}} = state), do: push(state)

  defp changed(state) do
    navigation = state.socket.navigation
    follow(send_diff(state), navigation)
  end

  defp push(state) do
    case Flow.check(state.flow, now()) do
      :now -> {:noreply, send_diff(state)}
      {:wait, ms} -> {:noreply, %{wake(state, ms) | dirty?: true}}
    end
  end

  defp wake(%{timer: nil} = state, ms),
    do: %{state | timer: Process.send_after(self(), :situ_live_render, ms)}

  # A timer is already running; when it fires, the remaining time is computed again.
  defp wake(state, _ms), do: state

  defp send_diff(state) do
    {diff, state} = diff(state, :changed)
    state = %{state | dirty?: false}

    if diff == %{} do
      state
    else
      diff = if state.flow.ack?, do: Map.update(diff, "e", [ack()], &(&1 ++ [ack()])), else: diff
      transmit(state, nil, [state.join_ref, nil, state.topic, "diff", diff])
      %{state | flow: Flow.sent(state.flow, now())}
    end
  end

  defp ack, do: ["situ:ack", %{}]

  defp diff(%{socket: socket} = state, what) do
    {diff, memory} = tree(socket, state.memory, what)

    diff =
      diff
      |> put("e", socket.events != [], fn -> Enum.reverse(socket.events) end)
      |> put("r", socket.reply != nil, fn -> socket.reply end)
      |> put("t", title?(socket, what), fn -> socket.assigns.page_title end)

    {diff, %{state | socket: Socket.__sent__(socket), memory: memory}}
  end

  defp tree(%{assigns: %{__changed__: changed}}, memory, :changed) when changed == %{},
    do: {%{}, memory}

  defp tree(socket, memory, what) do
    case Diff.run(Page.render(socket, what), memory) do
      :stale -> Diff.run(Page.render(socket, :all), memory)
      result -> result
    end
  end

  defp title?(%{assigns: %{page_title: title} = assigns}, what) when is_binary(title),
    do: what == :all or is_map_key(assigns.__changed__, :page_title)

  defp title?(_, _), do: false

  defp put(diff, key, true, value), do: Map.put(diff, key, value.())
  defp put(diff, _, false, _), do: diff

  defp follow(state, nil), do: {:noreply, state}

  defp follow(state, {:live_patch, %{"to" => to} = target}) do
    outward = outward(state, target)
    transmit(state, nil, [state.join_ref, nil, state.topic, "live_patch", outward])

    case Page.find(state.config, to) do
      {:ok, %{target: view} = route, params} when view == state.socket.view ->
        changed(%{state | route: route, socket: patch(state, route, params, to)})

      _ ->
        raise ArgumentError,
              "invalid push_patch to #{inspect(to)}: this is not a page of #{inspect(state.socket.view)}"
    end
  end

  defp follow(state, {kind, target}) do
    outward = outward(state, target)
    transmit(state, nil, [state.join_ref, nil, state.topic, Atom.to_string(kind), outward])
    {:noreply, state}
  end

  defp reply(state, ref, status, response) do
    payload = %{"status" => status, "response" => response}
    transmit(state, ref, [state.join_ref, ref, state.topic, "phx_reply", payload])
  end

  defp transmit(state, ref, message) do
    send(state.transport, {:situ_live, state.topic, ref, JSON.encode(message)})
    :ok
  end

  # An exception ends the process with a reason that contains no assigns, because crash reports may be read by others.
  defp guard(state, fun) do
    fun.(state)
  catch
    kind, reason ->
      log(kind, reason, __STACKTRACE__)
      {:stop, {:shutdown, :crashed}, state}
  end

  defp log(kind, reason, stack), do: Logger.error(Exception.format(kind, reason, stack))

  defp now, do: System.monotonic_time(:millisecond)

  @impl true
  def terminate(reason, %__MODULE__{socket: %Socket{view: view} = socket}) do
    if function_exported?(view, :terminate, 2), do: view.terminate(reason, socket)
  end

  def terminate(_, _), do: :ok

  @impl true
  def format_status(_reason, [_dictionary, _state]), do: [data: [{~c"State", :hidden}]]

  @doc false
  def supervisor(ref), do: {:via, Registry, {Situ.Live.Registry, {ref, :views}}}

  @doc false
  @spec start(Endpoint.t(), map()) :: DynamicSupervisor.on_start_child()
  def start(config, join),
    do: DynamicSupervisor.start_child(supervisor(config.ref), {__MODULE__, join})

  @doc false
  def parameters(request), do: Map.drop(request.query, ["vsn", "token"])
end
