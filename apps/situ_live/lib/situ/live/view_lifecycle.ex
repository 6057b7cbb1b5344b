defmodule Situ.Live.ViewLifecycle do
  @moduledoc false
  # Maps an address to a mounted view, in the same way for the dead render, a join and a patch.
  alias Situ.Live.{Endpoint, Html, PublicAddress, Query, Rendered, Request, Route, Socket, View}

  @spec fetch_route(Endpoint.t(), String.t()) :: {:ok, Route.t(), map()} | :error
  def fetch_route(config, url) when is_binary(url) do
    uri = URI.parse(url)
    target = (uri.path || "/") <> if(uri.query, do: "?" <> uri.query, else: "")

    with {:ok, request} <- Request.new("GET", target, %{}),
         request = %{
           request
           | segments: PublicAddress.strip_base(config.public, request.segments)
         },
         {:ok, %Route{kind: :live} = route, params} <- Route.match_request(config.routes, request) do
      {:ok, route, Map.merge(request.query, params)}
    else
      _ -> :error
    end
  end

  def fetch_route(_, _), do: :error

  @doc """
  Returns the scope of a session's token: the view, or all views whose routes have the same fixed session. If a route
  computes its session from the request, or may refuse it, only a page of that route may join.
  """
  @spec session_scope(Route.t()) :: String.t()
  def session_scope(%Route{opts: opts, target: view}) do
    case opts[:session] do
      session when is_function(session) -> inspect(view)
      session -> "session #{:erlang.phash2(session || %{}, 4_294_967_296)}"
    end
  end

  @spec mount_view(Route.t(), map(), map(), String.t(), Socket.t()) :: Socket.t()
  def mount_view(route, params, session, uri, socket) do
    socket = Socket.assign(%{socket | view: route.target}, :live_action, route.opts[:action])
    socket = View.call_mount(route.target, params, session, socket)

    if socket.navigation,
      do: socket,
      else: View.call_handle_params(route.target, params, uri, socket)
  end

  @spec render_view(Socket.t(), :all | :changed) :: Rendered.t()
  def render_view(%Socket{} = socket, scope) do
    assigns = if scope == :all, do: %{socket.assigns | __changed__: nil}, else: socket.assigns
    add_flow_hook(socket, socket.view.render(assigns))
  end

  @fingerprint :erlang.phash2({__MODULE__, :wrap}, 4_294_967_296)

  # The hook that acknowledges diffs (see Situ.Live.DiffPacing) needs an element to attach to.
  defp add_flow_hook(socket, %Rendered{} = rendered) do
    %Rendered{
      static: [~s(<i id="#{socket.id}-flow" phx-hook="SituFlow" hidden></i>), ""],
      dynamic: [Html.escape(rendered)],
      fingerprint: @fingerprint
    }
  end

  defp add_flow_hook(socket, other) do
    raise ArgumentError,
          "#{inspect(socket.view)}.render/1 must return ~H, got: #{inspect(other, limit: 5)}"
  end

  @doc "Converts the value of a form or a click to the map that handle_event/3 receives."
  @spec event_params(String.t(), term(), term()) :: {:ok, map()} | :error
  def event_params("form", value, meta) when is_binary(value) do
    case Query.parse(value) do
      {:ok, params} -> {:ok, Map.merge(params, target_param(meta))}
      _ -> :error
    end
  end

  def event_params(_type, nil, _meta), do: {:ok, %{}}
  def event_params(_type, %{} = value, _meta), do: {:ok, value}
  def event_params(_type, value, _meta), do: {:ok, %{"value" => value}}

  # The browser sends the field name as in the form; handle_event/3 receives the path within the parameters.
  defp target_param(%{"_target" => name}) when is_binary(name) do
    case Query.field_path(name) do
      path when is_list(path) -> %{"_target" => path}
      :error -> %{}
    end
  end

  defp target_param(_), do: %{}
end
