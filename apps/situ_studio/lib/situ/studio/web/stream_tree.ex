defmodule Situ.Studio.Web.StreamTree do
  @moduledoc false
  # The tree of streams beside the panels: what is found, what is folded, what stands beside the names.
  import Situ.Live.Socket, only: [assign: 2]

  alias Situ.Live.Socket
  alias Situ.Studio.{StreamInfo, Tree}
  alias Situ.Studio.Web.Side

  @max_rows 400

  @spec handle_event(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_event("search", %{"query" => query}, socket) when is_binary(query),
    do: assign(socket, query: String.slice(query, 0, 200))

  def handle_event("toggle", %{"path" => path}, socket) when is_binary(path) do
    closed = socket.assigns.closed

    cond do
      path in closed -> assign(socket, closed: MapSet.delete(closed, path))
      group?(socket.assigns.infos, path) -> assign(socket, closed: MapSet.put(closed, path))
      true -> socket
    end
  end

  def handle_event("fold_all", _, socket) do
    groups =
      for row <- socket.assigns.infos |> Tree.build(& &1.name) |> Tree.rows(MapSet.new()),
          row.open?,
          into: MapSet.new(),
          do: row.path

    assign(socket, closed: groups)
  end

  def handle_event("unfold_all", _, socket), do: assign(socket, closed: MapSet.new())

  def handle_event("info_next", _, socket),
    do: assign(socket, info: Side.next_info(socket.assigns.info))

  def handle_event(_, _, socket), do: socket

  # Only what can be folded is remembered as folded.
  defp group?(infos, path), do: Enum.any?(infos, &String.starts_with?(&1.name, path <> "."))

  @doc "The rows to show, and how many more there are."
  @spec rows(%{
          :query => String.t(),
          :infos => [StreamInfo.t()],
          :closed => MapSet.t(),
          optional(atom()) => term()
        }) :: {[map()], non_neg_integer()}
  def rows(%{query: "", infos: streams, closed: closed}) do
    streams |> Tree.build(& &1.name) |> Tree.rows(closed) |> cut()
  end

  def rows(%{query: query, infos: streams}) do
    # by name and by type
    streams
    |> Tree.search(query, &"#{&1.name} #{&1.type}")
    |> Tree.build(& &1.name)
    |> Tree.rows(MapSet.new())
    |> cut()
  end

  defp cut(rows), do: {Enum.take(rows, @max_rows), max(length(rows) - @max_rows, 0)}
end
