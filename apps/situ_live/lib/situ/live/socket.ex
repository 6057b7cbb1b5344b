defmodule Situ.Live.Socket do
  @moduledoc """
  The state of one view. Views read `socket.assigns` and change it with the functions that `use Situ.Live.View` imports.

      def handle_event("save", %{"name" => name}, socket),
        do: {:noreply, socket |> assign(name: name) |> push_event("saved", %{}) |> push_patch(to: "/rooms")}
  """
  alias Situ.Live.Stream

  defstruct assigns: %{__changed__: %{}, live_action: nil},
            id: nil,
            view: nil,
            endpoint: nil,
            connected?: false,
            # for the runtime only: contents of the next message to the browser
            events: [],
            reply: nil,
            navigation: nil

  @type t :: %__MODULE__{}

  @max_events 1_000

  @doc "Sets assigns; setting an assign to its current value does not mark it as changed."
  @spec assign(t() | map(), Enumerable.t()) :: t() | map()
  def assign(target, pairs),
    do: Enum.reduce(pairs, target, fn {k, v}, acc -> assign(acc, k, v) end)

  @doc "Sets one assign of a socket or of a component's assigns."
  @spec assign(t() | map(), atom(), term()) :: t() | map()
  def assign(%__MODULE__{assigns: assigns} = socket, key, value) when is_atom(key) do
    case assigns do
      %{^key => ^value} -> socket
      _ -> %{socket | assigns: assigns |> Map.put(key, value) |> mark_changed(key)}
    end
  end

  def assign(%{__changed__: _} = assigns, key, value) when is_atom(key) do
    case assigns do
      %{^key => ^value} -> assigns
      _ -> assigns |> Map.put(key, value) |> mark_changed(key)
    end
  end

  defp mark_changed(%{__changed__: %{} = changed} = assigns, key),
    do: %{assigns | __changed__: Map.put(changed, key, true)}

  defp mark_changed(assigns, _), do: assigns

  @doc "Sets an assign to the result of `fun` unless it exists."
  @spec assign_new(t() | map(), atom(), (() -> term())) :: t() | map()
  def assign_new(target, key, fun) when is_function(fun, 0) do
    if is_map_key(get_assigns(target), key), do: target, else: assign(target, key, fun.())
  end

  defp get_assigns(%__MODULE__{assigns: assigns}), do: assigns
  defp get_assigns(assigns), do: assigns

  @doc "Updates an assign with a function of its current value."
  @spec update(t() | map(), atom(), (term() -> term())) :: t() | map()
  def update(target, key, fun),
    do: assign(target, key, fun.(Map.fetch!(get_assigns(target), key)))

  @doc "Sends an event with a JSON-able map to client hooks that listen (`this.handleEvent(name, ...)`)."
  @spec push_event(t(), String.t(), map()) :: t()
  def push_event(%__MODULE__{events: events} = socket, name, %{} = payload) do
    # A browser that stops receiving must not fill the memory, so the oldest events are dropped.
    %{socket | events: Enum.take([[name, payload] | events], @max_events)}
  end

  @doc "Changes the address without leaving the view: `to:` a path; `replace: true` adds no history entry."
  @spec push_patch(t(), keyword()) :: t()
  def push_patch(socket, opts), do: put_navigation(socket, :live_patch, opts)

  @doc "Navigates to another view on the same connection."
  @spec push_navigate(t(), keyword()) :: t()
  def push_navigate(socket, opts), do: put_navigation(socket, :live_redirect, opts)

  @doc "Redirects the browser to another page: `to:` a path, or `external:` a URL."
  @spec redirect(t(), keyword()) :: t()
  def redirect(%__MODULE__{} = socket, to: to),
    do: %{socket | navigation: {:redirect, %{"to" => local_path!(to)}}}

  def redirect(%__MODULE__{} = socket, external: url),
    do: %{socket | navigation: {:redirect, %{"to" => url}}}

  defp put_navigation(%__MODULE__{} = socket, kind, opts) do
    to = opts |> Keyword.fetch!(:to) |> local_path!()
    history = if opts[:replace], do: "replace", else: "push"
    %{socket | navigation: {kind, %{"to" => to, "kind" => history}}}
  end

  defp local_path!("//" <> _ = to),
    do: raise(ArgumentError, "to: must be a path, got: #{inspect(to)}")

  defp local_path!("/" <> _ = to), do: to
  defp local_path!(to), do: raise(ArgumentError, "to: must be a path, got: #{inspect(to)}")

  @doc "Returns whether a browser is connected: false in the first, dead render of a page. Subscribe only if true."
  @spec connected?(t()) :: boolean()
  def connected?(%__MODULE__{connected?: connected?}), do: connected?

  @doc """
  Creates or extends a list that only the browser keeps: the server sends inserts and deletes and then discards them.

      # mount:   stream(socket, :lines, lines)
      # event:   stream_insert(socket, :lines, line, at: 0, limit: 200)
      <ul id="lines" phx-update="stream">
        <li :for={{id, line} <- @streams.lines} id={id}>{line.text}</li>
      </ul>

  Each item needs an `:id`, or the option `dom_id:` with a function that returns the row's id. Options: `at:` (the
  position of the items, default -1, the end), `limit:` (the number of rows that the browser keeps), `reset:` (whether
  to remove all earlier rows), `dom_id:`.
  """
  @spec stream(t(), atom(), Enumerable.t(), keyword()) :: t()
  def stream(socket, name, items, opts \\ []) do
    case socket.assigns[:streams] do
      %{^name => stream} ->
        stream = if opts[:reset], do: %{Stream.clear(stream) | reset?: true}, else: stream
        put_stream(socket, name, Enum.reduce(items, stream, &Stream.insert(&2, &1, opts)))

      _ ->
        put_stream(socket, name, Stream.new(name, items, opts))
    end
  end

  @doc "Inserts one item into a stream, or updates its row; options `at:` (default -1, the end), `limit:`."
  @spec stream_insert(t(), atom(), term(), keyword()) :: t()
  def stream_insert(socket, name, item, opts \\ []),
    do: put_stream(socket, name, Stream.insert(fetch_stream!(socket, name), item, opts))

  @doc "Deletes an item from a stream."
  @spec stream_delete(t(), atom(), term()) :: t()
  def stream_delete(socket, name, item) do
    stream = fetch_stream!(socket, name)
    put_stream(socket, name, Stream.delete(stream, stream.dom_id.(item)))
  end

  defp fetch_stream!(socket, name) do
    case socket.assigns do
      %{streams: %{^name => stream}} -> stream
      _ -> raise ArgumentError, "no stream #{inspect(name)}; create it with stream/3 in mount/3"
    end
  end

  defp put_stream(socket, name, stream) do
    streams = Map.get(socket.assigns, :streams, %{})
    assign(socket, :streams, Map.put(streams, name, stream))
  end

  @doc false
  # Clears the contents of a message that was sent.
  def __clear_message__(%__MODULE__{assigns: assigns} = socket) do
    assigns =
      case assigns do
        %{streams: streams} ->
          %{assigns | streams: Map.new(streams, fn {k, s} -> {k, Stream.clear(s)} end)}

        _ ->
          assigns
      end

    %{socket | assigns: %{assigns | __changed__: %{}}, events: [], reply: nil, navigation: nil}
  end
end
