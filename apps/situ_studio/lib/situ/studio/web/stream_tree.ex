defmodule Situ.Studio.Web.StreamTree do
  @moduledoc false
  # Handles the stream tree next to the panels: its search, its folded groups, and the statistic next to the names.
  import Situ.Live.Socket, only: [assign: 2]

  alias Situ.Live.Socket
  alias Situ.Studio.{StreamTotals, StreamInfo, Tree}

  @max_rows 400

  @spec handle_event(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_event("search", %{"query" => query} = params, socket) when is_binary(query) do
    info = StreamTotals.parse_choice(params["info"], socket.assigns.info)
    assign(socket, query: String.slice(query, 0, 200), info: info)
  end

  # Folds or unfolds everything below a group.
  def handle_event("fold_below", %{"path" => path, "open" => open?}, socket)
      when is_binary(path) do
    below =
      MapSet.filter(list_groups(socket), &(&1 == path or String.starts_with?(&1, path <> ".")))

    closed = socket.assigns.closed

    closed = if open?, do: MapSet.difference(closed, below), else: MapSet.union(closed, below)

    assign(socket, closed: closed)
  end

  def handle_event("toggle", %{"path" => path}, socket) when is_binary(path) do
    closed = socket.assigns.closed

    cond do
      path in closed -> assign(socket, closed: MapSet.delete(closed, path))
      group?(socket.assigns.infos, path) -> assign(socket, closed: MapSet.put(closed, path))
      true -> socket
    end
  end

  def handle_event("fold_all", _, socket), do: assign(socket, closed: list_groups(socket))

  def handle_event("unfold_all", _, socket), do: assign(socket, closed: MapSet.new())

  def handle_event(_, _, socket), do: socket

  defp list_groups(socket) do
    for row <- socket.assigns.infos |> Tree.build(& &1.name) |> Tree.visible_rows(MapSet.new()),
        row.open?,
        into: MapSet.new(),
        do: row.path
  end

  # Only groups can be folded.
  defp group?(infos, path), do: Enum.any?(infos, &String.starts_with?(&1.name, path <> "."))

  @doc "Returns the selected group with its streams, or nil."
  @spec selected_group(map()) :: %{path: String.t(), streams: [StreamInfo.t()]} | nil
  def selected_group(%{selected: {:group, path}, infos: streams}) do
    case Enum.filter(streams, &String.starts_with?(&1.name, path <> ".")) do
      [] -> nil
      streams -> %{path: path, streams: streams}
    end
  end

  def selected_group(_), do: nil

  @doc "Returns the rows to show, and the number of rows left out."
  @spec visible_rows(%{
          :query => String.t(),
          :infos => [StreamInfo.t()],
          :closed => MapSet.t(),
          optional(atom()) => term()
        }) :: {[map()], non_neg_integer()}
  def visible_rows(%{query: "", infos: streams, closed: closed}) do
    streams |> Tree.build(& &1.name) |> Tree.visible_rows(closed) |> limit_rows()
  end

  def visible_rows(%{query: query, infos: streams}) do
    # The search matches names and types.
    streams
    |> Tree.search(query, &"#{&1.name} #{&1.type}")
    |> Tree.build(& &1.name)
    |> Tree.visible_rows(MapSet.new())
    |> limit_rows()
  end

  defp limit_rows(rows), do: {Enum.take(rows, @max_rows), max(length(rows) - @max_rows, 0)}
end
