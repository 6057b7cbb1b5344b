defmodule Situ.Phoenix do
  @moduledoc """
  Situ in a Phoenix application: the studio with the application's own login (`Situ.Phoenix.Router`), live panels in
  its pages (`Situ.Phoenix.Components`), and the messages of a running pipeline in a LiveView:

      def mount(_params, _session, socket) do
        {:ok, socket |> assign(level: nil) |> Situ.Phoenix.subscribe({Lab.Pipeline, "Level"})}
      end

      def handle_info({:situ, "Level", %Situ.Message{data: level}}, socket),
        do: {:noreply, assign(socket, level: level)}

      def handle_info({:situ, "Level", _ended_or_error}, socket), do: {:noreply, socket}
  """
  import Phoenix.LiveView, only: [attach_hook: 4, connected?: 1]
  alias Situ.Subscription

  @doc """
  Subscribes a LiveView to a stream of a running pipeline. Call it in `mount/3`.

  The LiveView receives the events of `Situ.Subscription` as `{:situ, name, event}`. At most one message waits for it:
  while it is busy, newer messages replace each other, and the pipeline does not wait. Nothing is subscribed while the
  page is rendered without a connection.

  Options: `tag:` replaces the name in the events, `every:` is the minimum time between two messages in ms (33).
  """
  @spec subscribe(Phoenix.LiveView.Socket.t(), Subscription.target(), keyword()) ::
          Phoenix.LiveView.Socket.t()
  def subscribe(socket, {_pipeline, name} = target, opts \\ []) do
    if connected?(socket) do
      tag = opts[:tag] || name
      {:ok, subscription} = Subscription.start_link(target, opts)

      # The next message may be sent as soon as the LiveView handles this one, so that at most one is waiting.
      attach_hook(socket, {:situ, tag}, :handle_info, fn
        {:situ, ^tag, %Situ.Message{}}, socket ->
          Subscription.request_next(subscription)
          {:cont, socket}

        _other, socket ->
          {:cont, socket}
      end)
    else
      socket
    end
  end
end
