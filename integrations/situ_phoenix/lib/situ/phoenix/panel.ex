defmodule Situ.Phoenix.Panel do
  @moduledoc false
  # The live component of `Situ.Phoenix.Components.situ_panel/1`. Its subscription sends events as updates, because a
  # live component has no mailbox.
  use Phoenix.LiveComponent
  alias Situ.{Message, Subscription}
  alias Situ.Studio.Preview

  @impl true
  def update(%{event: event}, socket), do: {:ok, show_event(socket, event)}

  def update(assigns, socket) do
    changed? = assigns.stream != socket.assigns[:stream]
    socket = assign(socket, assigns)
    {:ok, if(changed?, do: start_subscription(socket), else: socket)}
  end

  defp start_subscription(socket) do
    if socket.assigns[:subscription], do: Subscription.stop(socket.assigns.subscription)
    socket = assign(socket, subscription: nil, points: %{}, drawing: "", note: "waiting")
    if connected?(socket), do: assign(socket, subscription: subscribe(socket)), else: socket
  end

  defp subscribe(%{assigns: %{id: id, stream: stream, every: every_ms}}) do
    view = self()
    deliver = &send_update(view, __MODULE__, id: id, event: &1)
    {:ok, subscription} = Subscription.start_link(stream, every: every_ms, deliver: deliver)
    subscription
  end

  defp show_event(socket, %Message{} = message) do
    Subscription.request_next(socket.assigns.subscription)
    draw(assign(socket, note: nil), Preview.kind(message.data), message)
  end

  defp show_event(socket, :ended), do: assign(socket, note: "the pipeline has ended")
  defp show_event(socket, error), do: assign(socket, note: error.what)

  defp draw(%{assigns: %{points: points, size: size}} = socket, :signal, message) do
    from = message.originating_time - socket.assigns.seconds * 1_000_000_000

    points =
      for {name, value} <- Preview.list_numbers(message.data), reduce: points do
        points ->
          Map.update(
            points,
            name,
            [{message.originating_time, value}],
            &[{message.originating_time, value} | &1]
          )
      end

    points =
      Map.new(points, fn {name, list} ->
        {name, Enum.take_while(list, &(elem(&1, 0) >= from)) |> Enum.take(1_000)}
      end)

    series = for {name, list} <- points, do: {name, Enum.reverse(list)}
    assign(socket, points: points, drawing: Preview.plot(series, size))
  end

  defp draw(socket, _kind, message), do: assign(socket, drawing: Preview.render(message.data))

  @impl true
  def render(assigns) do
    ~H"""
    <figure id={@id} class="situ-panel">
      <figcaption><%= @title %> <small :if={@note}><%= @note %></small></figcaption>
      <%= Phoenix.HTML.raw(@drawing) %>
    </figure>
    """
  end
end
