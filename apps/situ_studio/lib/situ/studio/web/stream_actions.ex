defmodule Situ.Studio.Web.StreamActions do
  @moduledoc false
  # Handles what people do with streams in the main view, except for showing them: they select them, let the cursor keep
  # to them, zoom to them, and ask for statistics.
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Live.Socket
  alias Situ.Studio.{Coverage, Int64, Layout, Statistics}
  alias Situ.Studio.Web.StreamTree

  @spec handle_event(String.t(), map(), Socket.t()) :: Socket.t()
  # A click on a group's name also folds it; its menu entry only selects it.
  def handle_event("select", %{"path" => path} = params, socket) when is_binary(path) do
    cond do
      Map.has_key?(socket.assigns.shapes, path) ->
        assign(socket, selected: {:stream, path})

      params["only"] ->
        assign(socket, selected: {:group, path})

      true ->
        socket = StreamTree.handle_event("toggle", %{"path" => path}, socket)
        assign(socket, selected: {:group, path})
    end
  end

  def handle_event("snap", %{"stream" => stream}, socket) do
    %{snap: now, shapes: shapes} = socket.assigns
    snap = if now != stream and is_map_key(shapes, stream), do: stream
    socket |> assign(snap: snap) |> push_event("snap", %{stream: snap})
  end

  # Zooms to one stream, or to all streams of a panel.
  def handle_event("zoom_stream", params, socket) do
    names = List.wrap(params["streams"] || params["stream"])

    case Coverage.total_extent(Enum.filter(socket.assigns.infos, &(&1.name in names))) do
      nil -> socket
      times -> push_event(socket, "zoom_to", times)
    end
  end

  # Computes statistics of the messages in the selection, for each stream of a panel.
  def handle_event("statistics", %{"panel" => id, "from" => from, "to" => to}, socket) do
    with {:ok, from} <- Int64.parse(from),
         {:ok, to} when to >= from <- Int64.parse(to),
         %{vis: vis} <- Layout.find_panel(socket.assigns.layout, id) do
      Statistics.compute_async(socket.assigns.source, vis, from, to)
      socket
    else
      _ -> socket
    end
  end

  def handle_event(_, _, socket), do: socket
end
