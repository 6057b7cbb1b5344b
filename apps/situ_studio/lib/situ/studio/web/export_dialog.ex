defmodule Situ.Studio.Web.ExportDialog do
  @moduledoc false
  # Handles the dialog "Save the selection as a recording": asks for a name, starts the export in a separate process,
  # and shows the path of the new recording.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Live.Socket
  alias Situ.Studio.{Catalog, Export, Int64}

  @doc "Returns whether the item is a recording on disk and the studio may write to it."
  @spec available?(map()) :: boolean()
  def available?(%{read_only: read_only, item: item}), do: item.kind == :store and not read_only

  @spec handle_event(String.t(), map(), Socket.t()) :: {:noreply, Socket.t()}
  def handle_event(event, params, socket) do
    if available?(socket.assigns),
      do: apply_event(event, params, socket),
      else: {:noreply, socket}
  end

  # The page sends the selection, or the visible range if nothing is selected.
  defp apply_event("export_dialog", %{"from" => from, "to" => to, "of" => of}, socket) do
    with {:ok, from} <- Int64.parse(from),
         {:ok, to} <- Int64.parse(to) do
      {:noreply, assign(socket, dialog: {:export, from, to, of == "selection"})}
    else
      :error -> {:noreply, socket}
    end
  end

  defp apply_event(
         "export_save",
         %{"name" => name} = params,
         %{assigns: %{dialog: {:export, from, to, _}}} = socket
       )
       when is_binary(name) do
    streams = if params["streams"] == "shown", do: shown_streams(socket.assigns), else: :all

    case Export.new(name, from, to, streams) do
      {:ok, export} ->
        start_export(export, socket.assigns)
        {:noreply, socket |> assign(dialog: nil) |> show_toast("Saving #{export.name} ...")}

      {:error, error} ->
        {:noreply, show_toast(socket, Exception.message(error))}
    end
  end

  defp apply_event(_, _, socket), do: {:noreply, socket}

  # The export continues after the page is closed.
  defp start_export(export, %{item: item, studio: studio}) do
    page = self()
    task = {Task, fn -> send(page, {:exported, Export.write_recording(export, item)}) end}
    {:ok, _} = DynamicSupervisor.start_child(Catalog.watch_supervisor(studio), task)
  end

  @doc "Shows the result of the export."
  @spec show_result({:ok, Path.t()} | {:error, Situ.Error.t()}, Socket.t()) :: Socket.t()
  def show_result({:ok, path}, socket), do: show_toast(socket, "Saved as #{path}")
  def show_result({:error, error}, socket), do: show_toast(socket, Exception.message(error))

  defp show_toast(socket, text), do: push_event(socket, "toast", %{text: text})

  defp shown_streams(%{layout: layout, shapes: shapes}) do
    for(panel <- layout.panels, v <- panel.vis, Map.has_key?(shapes, v.stream), do: v.stream)
    |> Enum.uniq()
  end

  attr(:dialog, :any, required: true)
  attr(:item, :any, required: true)
  attr(:layout, :any, required: true)
  attr(:shapes, :map, required: true)

  @doc false
  def export_dialog(%{dialog: {:export, from, to, selection?}} = assigns) do
    assigns =
      assign(assigns,
        length: Situ.Time.format_duration(to - from),
        what:
          if(selection?, do: "The selection", else: "The visible range (nothing is selected)"),
        all: map_size(assigns.shapes),
        shown: length(shown_streams(assigns)),
        folder: Path.dirname(assigns.item.path)
      )

    ~H"""
    <dialog id="export-dialog" phx-hook="Modal" phx-update="ignore"
        aria-label="Save a section as a recording">
      <form id="export-save" phx-submit="export_save">
        <h3>Save a section as a recording</h3>
        <p class="hint">{@what}: {@length}. The copy is written to {@folder}; this recording is not modified.</p>
        <input name="name" value={default_name(@item.title)} placeholder="Name" autocomplete="off" maxlength="60"
            aria-label="Name" autofocus>
        <div class="choices" role="radiogroup" aria-label="Streams">
          <label><input type="radio" name="streams" value="all" checked> All streams ({@all})</label>
          <label><input type="radio" name="streams" value="shown"> Only shown streams ({@shown})</label>
        </div>
        <div class="choices">
          <button class="btn primary" type="submit">Save</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
      </form>
    </dialog>
    """
  end

  # "lobby.0003" -> "lobby part"
  defp default_name(title) do
    title |> Path.basename() |> String.replace(~r/\.[^.]*\z/, "") |> Kernel.<>(" part")
  end
end
