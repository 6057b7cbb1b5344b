defmodule Situ.Studio.Web.LayoutMenu do
  @moduledoc false
  # Handles the layout of the main view, which the address chooses, or which is picked, saved or deleted in the menu.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Live.Socket
  alias Situ.Studio.{Comparison, Layout, Layouts, Link, Recordings, Settings, Int64}

  @doc "Chooses the layout that the page's address names, or the automatic one."
  @spec choose_layout(Socket.t(), map()) :: Socket.t()
  def choose_layout(socket, params) do
    auto = automatic_layout(socket.assigns)
    names = Layouts.list_names(socket.assigns.layout_dir)

    wanted = params["layout"] || Settings.load(socket.assigns.layout_dir).layout

    {saved, socket} =
      case Layouts.load(socket.assigns.layout_dir, text_param(wanted)) do
        {:ok, layout} ->
          {layout, socket}

        {:error, error} ->
          {auto, if(wanted == auto.name, do: socket, else: show_toast(socket, error))}
      end

    layout =
      case Link.decode(text_param(params["edit"])) do
        {:ok, layout} -> layout
        {:error, _} -> add_compared_streams(saved, socket.assigns)
      end

    socket =
      assign(socket,
        layout: layout,
        saved: saved,
        layouts: [Layout.Auto.layout_name() | names -- [auto.name]]
      )

    # An offset in the address takes precedence over the offset saved with the layout.
    if Int64.parse(params["offset"]) == :error,
      do: apply_saved_offset(socket, saved),
      else: socket
  end

  @doc """
  Rebuilds the automatic layout if nobody has changed it and a stream of plain values has turned out to have another
  shape; the streams of a running pipeline may have no known shape before their first messages. `shapes` are the shapes
  before the last refresh.
  """
  @spec update_automatic(Socket.t(), map()) :: Socket.t()
  def update_automatic(%{assigns: %{layout: same, saved: same} = assigns} = socket, shapes) do
    shape_found? = fn {name, shape} ->
      shape == :value and assigns.shapes[name] not in [:value, nil]
    end

    if Enum.any?(shapes, shape_found?), do: rebuild_automatic(socket), else: socket
  end

  def update_automatic(socket, _shapes), do: socket

  @doc "Rebuilds the automatic layout, unless another layout is shown or somebody has changed it."
  @spec rebuild_automatic(Socket.t()) :: Socket.t()
  def rebuild_automatic(%{assigns: %{layout: layout, saved: layout}} = socket) do
    if layout.name == Layout.Auto.layout_name(),
      do: choose_layout(socket, %{"layout" => layout.name}),
      else: socket
  end

  def rebuild_automatic(socket), do: socket

  # Applies the time offset that was saved with the layout, if it refers to the recording that is compared now.
  defp apply_saved_offset(
         %{assigns: %{compared: %{id: id} = compared, source: source}} = socket,
         %{
           compared: {id, offset}
         }
       ) do
    compared = %{compared | offset: offset}

    socket
    |> assign(compared: compared, source: Comparison.set_offset(source, offset))
    |> push_event("compare_shift", %{offset: Integer.to_string(offset)})
  end

  defp apply_saved_offset(socket, _), do: socket

  defp put_comparison(layout, %{compared: %Comparison{id: id, offset: offset}}),
    do: %{layout | compared: {id, offset}}

  defp put_comparison(layout, _), do: layout

  # A compared stream is shown in its counterpart's panel, and the edited layer in the annotation panel. The automatic
  # layout therefore has no panels for them.
  defp automatic_layout(assigns) do
    edited = assigns[:annotation] && Recordings.Layers.stream_name(assigns.annotation.stream)

    infos =
      Enum.reject(
        assigns.infos,
        &(&1.name == edited or Recordings.Comparison.compared_stream?(&1.name))
      )

    build_automatic(infos, assigns.source)
  end

  defp build_automatic(infos, source) do
    Layout.Auto.build_layout(
      infos,
      Layout.ImageLook.detect_looks(source, infos),
      Layout.SignalRange.detect_ranges(source, infos)
    )
  end

  defp add_compared_streams(layout, %{compared: nil}), do: layout

  defp add_compared_streams(layout, %{shapes: shapes}),
    do: Comparison.add_compared_streams(layout, Map.keys(shapes))

  @spec handle_event(String.t(), map(), Socket.t()) :: {:noreply, Socket.t()}
  def handle_event("layout_pick", %{"layout" => name}, socket) do
    layout =
      if name == Layout.Auto.layout_name(),
        do: {:ok, automatic_layout(socket.assigns)},
        else: Layouts.load(socket.assigns.layout_dir, name)

    case layout do
      {:ok, layout} ->
        shown = add_compared_streams(layout, socket.assigns)

        {:noreply,
         socket
         |> assign(layout: shown, saved: layout, selected: nil)
         |> apply_saved_offset(layout)}

      {:error, error} ->
        {:noreply, show_toast(socket, error)}
    end
  end

  # Shows some of the streams that the layout leaves out.
  def handle_event("layout_more", _, %{assigns: assigns} = socket) do
    more = assigns.layout |> Layout.left_out(assigns.infos) |> build_automatic(assigns.source)
    {:noreply, assign(socket, layout: Layout.append(assigns.layout, more))}
  end

  def handle_event("layout_dialog", _, %{assigns: %{read_only: false}} = socket),
    do: {:noreply, assign(socket, dialog: :layout)}

  def handle_event("layout_save", %{"name" => name}, %{assigns: %{read_only: false}} = socket) do
    layout = %{socket.assigns.layout | name: String.trim(to_string(name))}
    layout = put_comparison(layout, socket.assigns)

    case Layouts.save(socket.assigns.layout_dir, layout, socket.assigns.saved) do
      {:ok, layout} ->
        names = [Layout.Auto.layout_name() | Layouts.list_names(socket.assigns.layout_dir)]
        socket = assign(socket, layout: layout, saved: layout, layouts: names, dialog: nil)
        {:noreply, push_event(socket, "toast", %{text: "Layout saved"})}

      {:error, error} ->
        {:noreply, show_toast(socket, error)}
    end
  end

  def handle_event("layout_delete", _, %{assigns: %{read_only: false}} = socket) do
    Layouts.delete(socket.assigns.layout_dir, socket.assigns.saved.name)
    socket = assign(socket, dialog: nil)
    {:noreply, choose_layout(socket, %{})}
  end

  def handle_event(_, _, socket), do: {:noreply, socket}

  @doc "Saves the changed layout if it has a name and the settings ask for saving every change."
  @spec save_changes(Socket.t()) :: Socket.t()
  def save_changes(%{assigns: %{saved: saved, read_only: false} = assigns} = socket) do
    layout = put_comparison(assigns.layout, assigns)

    if layout != saved and layout.name != Layout.Auto.layout_name() and
         Settings.load(assigns.layout_dir).keep == :at_once do
      case Layouts.save(assigns.layout_dir, layout, saved) do
        {:ok, layout} -> assign(socket, layout: layout, saved: layout)
        {:error, error} -> show_toast(socket, error)
      end
    else
      socket
    end
  end

  def save_changes(socket), do: socket

  defp show_toast(socket, error),
    do: push_event(socket, "toast", %{text: Exception.message(error)})

  attr(:saved, :any, required: true)

  @doc false
  def save_dialog(assigns) do
    ~H"""
    <dialog id="layout-dialog" phx-hook="Modal" phx-update="ignore" aria-label="Save the layout">
      <form id="layout-save" phx-submit="layout_save">
        <h3>Save the layout</h3>
        <input name="name" value={if @saved.name == Layout.Auto.layout_name(), do: "", else: @saved.name}
            placeholder="Name" autocomplete="off" maxlength="60" aria-label="Name" autofocus>
        <div class="choices">
          <button class="btn primary" type="submit">Save</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
          <button :if={@saved.name != Layout.Auto.layout_name()} class="btn" type="button"
              data-sure="Delete this layout?" phx-click="layout_delete">Delete {@saved.name}</button>
        </div>
      </form>
    </dialog>
    """
  end

  defp text_param(value), do: if(is_binary(value), do: value, else: "")
end
