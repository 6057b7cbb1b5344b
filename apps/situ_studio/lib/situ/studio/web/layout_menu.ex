defmodule Situ.Studio.Web.LayoutMenu do
  @moduledoc false
  # The layout of the main view: chosen by the page's address, picked from the menu, saved under a name, or deleted.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Live.Socket
  alias Situ.Studio.{Comparison, Layout, Layouts, Link, Settings, WholeNumber}
  alias Situ.Studio.Source.Beside

  @doc "Chooses the layout that the page's address names, or the automatic one."
  @spec choose(Socket.t(), map()) :: Socket.t()
  def choose(socket, params) do
    auto = automatic(socket.assigns)
    names = Layouts.names(socket.assigns.layout_dir)

    wanted = params["layout"] || Settings.load(socket.assigns.layout_dir).layout

    {saved, socket} =
      case Layouts.load(socket.assigns.layout_dir, text(wanted)) do
        {:ok, layout} -> {layout, socket}
        {:error, error} -> {auto, if(wanted == auto.name, do: socket, else: toast(socket, error))}
      end

    layout =
      case Link.decode(text(params["edit"])) do
        {:ok, layout} -> layout
        {:error, _} -> beside(saved, socket.assigns)
      end

    socket =
      assign(socket,
        layout: layout,
        saved: saved,
        layouts: [Layout.Auto.name() | names -- [auto.name]]
      )

    # an offset in the address takes precedence over the offset saved with the layout
    if WholeNumber.parse(params["offset"]) == :error, do: shifted(socket, saved), else: socket
  end

  @doc """
  Rebuilds the automatic layout if nobody has changed it and a stream of plain values has turned out to have another
  shape; the streams of a running pipeline may have no known shape before their first messages. `shapes` are the shapes
  before the last refresh.
  """
  @spec learned(Socket.t(), map()) :: Socket.t()
  def learned(%{assigns: %{layout: layout, saved: layout} = assigns} = socket, shapes) do
    told? = fn {name, shape} -> shape == :value and assigns.shapes[name] not in [:value, nil] end
    automatic? = layout.name == Layout.Auto.name()

    if automatic? and Enum.any?(shapes, told?),
      do: choose(socket, %{"layout" => layout.name}),
      else: socket
  end

  def learned(socket, _shapes), do: socket

  # Applies the time offset that was saved with the layout, if it refers to the recording that is compared now.
  defp shifted(%{assigns: %{compared: %{id: id} = compared, source: source}} = socket, %{
         compared: {id, offset}
       }) do
    compared = %{compared | offset: offset}

    socket
    |> assign(compared: compared, source: Comparison.align(source, offset))
    |> push_event("compare_shift", %{offset: Integer.to_string(offset)})
  end

  defp shifted(socket, _), do: socket

  defp compared(layout, %{compared: %Comparison{id: id, offset: offset}}),
    do: %{layout | compared: {id, offset}}

  defp compared(layout, _), do: layout

  # A compared stream is shown in its counterpart's panel, so the automatic layout has no panels for it.
  defp automatic(assigns) do
    infos = Enum.reject(assigns.infos, &Beside.second?(&1.name))
    Layout.Auto.layout(infos, Layout.Look.all(assigns.source, infos))
  end

  defp beside(layout, %{compared: nil}), do: layout
  defp beside(layout, %{shapes: shapes}), do: Comparison.layout(layout, Map.keys(shapes))

  @spec handle_event(String.t(), map(), Socket.t()) :: {:noreply, Socket.t()}
  def handle_event("layout_pick", %{"layout" => name}, socket) do
    layout =
      if name == Layout.Auto.name(),
        do: {:ok, automatic(socket.assigns)},
        else: Layouts.load(socket.assigns.layout_dir, name)

    case layout do
      {:ok, layout} ->
        shown = beside(layout, socket.assigns)

        {:noreply,
         socket |> assign(layout: shown, saved: layout, selected: nil) |> shifted(layout)}

      {:error, error} ->
        {:noreply, toast(socket, error)}
    end
  end

  def handle_event("layout_dialog", _, %{assigns: %{read_only: false}} = socket),
    do: {:noreply, assign(socket, dialog: :layout)}

  def handle_event("layout_save", %{"name" => name}, %{assigns: %{read_only: false}} = socket) do
    layout = %{socket.assigns.layout | name: String.trim(to_string(name))}
    layout = compared(layout, socket.assigns)

    case Layouts.save(socket.assigns.layout_dir, layout) do
      :ok ->
        names = [Layout.Auto.name() | Layouts.names(socket.assigns.layout_dir)]
        socket = assign(socket, layout: layout, saved: layout, layouts: names, dialog: nil)
        {:noreply, push_event(socket, "toast", %{text: "Layout saved"})}

      {:error, error} ->
        {:noreply, toast(socket, error)}
    end
  end

  def handle_event("layout_delete", _, %{assigns: %{read_only: false}} = socket) do
    Layouts.delete(socket.assigns.layout_dir, socket.assigns.saved.name)
    socket = assign(socket, dialog: nil)
    {:noreply, choose(socket, %{})}
  end

  def handle_event(_, _, socket), do: {:noreply, socket}

  @doc "Saves the changed layout if it has a name and the settings ask for saving every change."
  @spec keep(Socket.t()) :: Socket.t()
  def keep(%{assigns: %{saved: saved, read_only: false} = assigns} = socket) do
    layout = compared(assigns.layout, assigns)

    if layout != saved and layout.name != Layout.Auto.name() and
         Settings.load(assigns.layout_dir).keep == :at_once do
      case Layouts.save(assigns.layout_dir, layout) do
        :ok -> assign(socket, layout: layout, saved: layout)
        {:error, error} -> toast(socket, error)
      end
    else
      socket
    end
  end

  def keep(socket), do: socket

  defp toast(socket, error), do: push_event(socket, "toast", %{text: Exception.message(error)})

  attr(:saved, :any, required: true)

  @doc false
  def dialog(assigns) do
    ~H"""
    <dialog id="layout-dialog" phx-hook="Modal" phx-update="ignore" aria-label="Save the layout">
      <form id="layout-save" phx-submit="layout_save">
        <h3>Save the layout</h3>
        <input name="name" value={if @saved.name == Layout.Auto.name(), do: "", else: @saved.name}
            placeholder="Name" autocomplete="off" maxlength="60" aria-label="Name" autofocus>
        <div class="choices">
          <button class="btn primary" type="submit">Save</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
          <button :if={@saved.name != Layout.Auto.name()} class="btn" type="button"
              data-sure="Delete this layout?" phx-click="layout_delete">Delete {@saved.name}</button>
        </div>
      </form>
    </dialog>
    """
  end

  defp text(value), do: if(is_binary(value), do: value, else: "")
end
