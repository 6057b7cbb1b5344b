defmodule Situ.Live.View do
  @moduledoc """
  A page whose state lives on the server. It uses the callbacks and names of `Phoenix.LiveView`.

      defmodule Counter do
        use Situ.Live.View

        @impl true
        def mount(_params, _session, socket), do: {:ok, assign(socket, count: 0)}

        @impl true
        def handle_event("inc", _params, socket), do: {:noreply, update(socket, :count, &(&1 + 1))}

        @impl true
        def render(assigns) do
          ~H\"\"\"
          <button id="inc" phx-click="inc">{@count}</button>
          \"\"\"
        end
      end

  A page is mounted twice: once for its first HTML (`connected?(socket)` is false), and once in its own process when
  the browser connects. `handle_params/3` is called after each `mount/3` and each patch of the address.

  A form's fields arrive as nested maps of strings; `"_target"` names the field that changed. An exception in a callback
  ends only this view's process. The browser mounts a new one within about a second and keeps the text in forms.

  `assign(socket, :page_title, "...")` sets the title.
  """
  alias Situ.Live.Socket

  @callback mount(params :: map(), session :: map(), Socket.t()) ::
              {:ok, Socket.t()} | {:ok, Socket.t(), keyword()}
  @callback handle_params(params :: map(), uri :: String.t(), Socket.t()) ::
              {:noreply, Socket.t()}
  @callback handle_event(event :: String.t(), params :: map(), Socket.t()) ::
              {:noreply, Socket.t()} | {:reply, map(), Socket.t()}
  @callback handle_info(message :: term(), Socket.t()) :: {:noreply, Socket.t()}
  @callback render(assigns :: map()) :: Situ.Live.Rendered.t()
  @callback terminate(reason :: term(), Socket.t()) :: term()
  @optional_callbacks mount: 3, handle_params: 3, handle_event: 3, handle_info: 2, terminate: 2

  @doc false
  defmacro __using__(_opts) do
    quote do
      @behaviour Situ.Live.View
      use Situ.Live.Component
      import Situ.Live.Socket, only: :functions
      alias Situ.Live.JS
    end
  end

  @doc false
  @spec call_mount(module(), map(), map(), Socket.t()) :: Socket.t()
  def call_mount(view, params, session, socket) do
    if function_exported?(view, :mount, 3) do
      case view.mount(params, session, socket) do
        {:ok, %Socket{} = socket} -> socket
        {:ok, %Socket{} = socket, _opts} -> socket
        other -> raise_bad_return!(view, "mount/3", other)
      end
    else
      socket
    end
  end

  @doc false
  @spec call_handle_params(module(), map(), String.t(), Socket.t()) :: Socket.t()
  def call_handle_params(view, params, uri, socket) do
    if function_exported?(view, :handle_params, 3),
      do: unwrap_noreply!(view.handle_params(params, uri, socket), view, "handle_params/3"),
      else: socket
  end

  @doc false
  @spec call_handle_event(module(), String.t(), map(), Socket.t()) :: Socket.t()
  def call_handle_event(view, name, params, socket) do
    if function_exported?(view, :handle_event, 3) do
      case view.handle_event(name, params, socket) do
        {:reply, %{} = reply, %Socket{} = socket} -> %{socket | reply: reply}
        other -> unwrap_noreply!(other, view, "handle_event/3")
      end
    else
      raise ArgumentError, "#{inspect(view)} has no handle_event/3 for #{inspect(name)}"
    end
  end

  @doc false
  @spec call_handle_info(module(), term(), Socket.t()) :: Socket.t()
  def call_handle_info(view, message, socket) do
    if function_exported?(view, :handle_info, 2),
      do: unwrap_noreply!(view.handle_info(message, socket), view, "handle_info/2"),
      else: socket
  end

  defp unwrap_noreply!({:noreply, %Socket{} = socket}, _view, _), do: socket
  defp unwrap_noreply!(other, view, callback), do: raise_bad_return!(view, callback, other)

  defp raise_bad_return!(view, callback, other) do
    raise ArgumentError,
          "invalid result of #{inspect(view)}.#{callback}: #{inspect(other, limit: 5)}"
  end
end
