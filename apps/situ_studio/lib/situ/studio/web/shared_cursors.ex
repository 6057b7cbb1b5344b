defmodule Situ.Studio.Web.SharedCursors do
  @moduledoc false
  # Shares the cursor and visible range of a browser with others that view the same recording or pipeline. They show
  # its cursor or follow it. The server only forwards these messages and stores nothing.
  import Situ.Live.Socket, only: [connected?: 1, push_event: 3]

  alias Situ.Live.Socket
  alias Situ.Studio.Int64

  @registry Situ.Studio.Peers

  @doc "Subscribes the page to the views of other pages that show the same item."
  @spec join(Socket.t()) :: Socket.t()
  def join(%{assigns: assigns} = socket) do
    if connected?(socket), do: {:ok, _} = Registry.register(@registry, peer_key(assigns), nil)
    socket
  end

  defp peer_key(%{studio: studio, id: id}), do: {studio, id}

  @doc "Sends this page's view to the other pages; an invalid view is dropped."
  @spec broadcast_view(Socket.t(), map()) :: Socket.t()
  def broadcast_view(%{assigns: assigns} = socket, params) do
    with {:ok, view} <- parse_view(params) do
      page = self()

      Registry.dispatch(@registry, peer_key(assigns), fn pages ->
        for {pid, _} <- pages, pid != page, do: send(pid, {:together, view})
      end)
    end

    socket
  end

  @doc "Pushes the view of another page to this page's script."
  @spec push_view(Socket.t(), map()) :: Socket.t()
  def push_view(socket, view), do: push_event(socket, "together", view)

  # Expects who, name, cursor, view and live as the page sends them; times are integer nanoseconds as strings.
  defp parse_view(
         %{"who" => who, "name" => name, "cursor" => cursor, "view" => [from, to]} = params
       )
       when is_binary(who) and byte_size(who) <= 40 and is_binary(name) do
    with {:ok, _} <- Int64.parse(cursor),
         {:ok, a} <- Int64.parse(from),
         {:ok, b} when b > a <- Int64.parse(to) do
      {:ok,
       %{
         who: who,
         name: String.slice(name, 0, 60),
         cursor: cursor,
         view: [from, to],
         live: params["live"] == true,
         gone: params["gone"] == true
       }}
    else
      _ -> :error
    end
  end

  defp parse_view(_), do: :error
end
