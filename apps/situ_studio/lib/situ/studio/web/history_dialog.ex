defmodule Situ.Studio.Web.HistoryDialog do
  @moduledoc false
  # The dialog that lists who changed a dataset or an annotation layer, and restores earlier versions.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Annotation.Editor
  alias Situ.Dataset
  alias Situ.Dataset.Server
  alias Situ.Live.Socket
  alias Situ.Studio.Annotations.Home

  @most 200

  @doc "Handles the events of the dialog on a dataset's page."
  @spec handle_dataset(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_dataset("history_dialog", _params, socket) do
    show_entries(
      socket,
      Dataset.History.list(Server.get_dataset(socket.assigns.server)),
      "history_restore"
    )
  end

  def handle_dataset("history_restore", params, socket),
    do: edit_dataset(socket, &Dataset.History.restore(&1, version_param(params)), params)

  def handle_dataset("history_undo", params, socket),
    do: edit_dataset(socket, &Dataset.History.undo/1, params)

  def handle_dataset(_event, _params, socket), do: socket

  defp edit_dataset(socket, fun, params) do
    case Server.edit(socket.assigns.server, fun) do
      {:ok, dataset} ->
        socket |> assign(dataset: dataset, dialog: nil) |> show_toast(describe_done(params))

      {:error, error} ->
        show_toast(socket, Exception.message(error))
    end
  end

  @doc "Handles the events of the dialog for the layer that the page edits."
  @spec handle_layer(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_layer("annotation_history", _params, %{assigns: %{annotation: %{}}} = socket) do
    %{item: item, annotation: %{stream: stream}} = socket.assigns
    layer = {Home.find_store(item.layers, stream), stream}
    show_entries(socket, Situ.Annotation.History.list(layer), "annotation_history_restore")
  end

  def handle_layer(
        "annotation_history_restore",
        params,
        %{assigns: %{annotation: %{editor: editor}}} = socket
      ) do
    with {n, ""} <- Integer.parse(version_param(params)),
         {:ok, _} <- Editor.restore(editor, n) do
      socket |> assign(dialog: nil) |> show_toast(describe_done(params))
    else
      {:error, error} -> show_toast(socket, Exception.message(error))
      _ -> socket
    end
  end

  def handle_layer(_event, _params, socket), do: socket

  defp version_param(%{"version" => version}) when is_binary(version),
    do: String.slice(version, 0, 20)

  defp version_param(_), do: ""

  defp describe_done(%{"version" => version}) when is_binary(version),
    do: "Version #{String.slice(version, 0, 20)} is restored"

  defp describe_done(_), do: "Your last edit is undone"

  defp show_entries(socket, {:ok, entries}, restore) do
    latest = entries |> Enum.reverse() |> Enum.take(@most)
    assign(socket, dialog: {:history, latest, restore})
  end

  defp show_entries(socket, {:error, error}, _restore),
    do: show_toast(socket, Exception.message(error))

  defp show_toast(socket, text), do: push_event(socket, "toast", %{text: text})

  attr(:entries, :list, required: true)
  attr(:restore, :string, required: true)

  @doc false
  def history_dialog(assigns) do
    ~H"""
    <dialog id="history" class="task" phx-hook="Modal" aria-label="History">
      <h3>History</h3>
      <p :if={@entries == []} class="hint">There are no edits yet.</p>
      <div class="history" tabindex="0" role="region" aria-label="Edits, newest first">
        <table>
          <thead :if={@entries != []}>
            <tr><th>Version</th><th>Time (UTC)</th><th>Who</th><th>Edit</th><th></th></tr>
          </thead>
          <tbody>
            <tr :for={e <- @entries} :key={e.version}>
              <td>{e.version}</td>
              <td>{format_time(e.at)}</td>
              <td title={e.program}>{e.by || "unknown"}</td>
              <td>{e.what}</td>
              <td><button :if={e.version != hd(@entries).version} class="btn" type="button" phx-click={@restore}
                  phx-value-version={e.version}
                  aria-label={"Restore version #{e.version}"}>Restore</button></td>
            </tr>
          </tbody>
        </table>
      </div>
      <div class="choices">
        <button :if={@restore == "history_restore" and @entries != []} class="btn" type="button"
            phx-click="history_undo">Undo my last edit</button>
        <button class="btn" type="button" phx-click="dialog_close" autofocus>Close</button>
      </div>
      <p class="hint">Restoring adds a new edit, so nothing is removed from the history.</p>
    </dialog>
    """
  end

  defp format_time(nil), do: ""
  defp format_time(text), do: text |> String.replace("T", " ") |> String.slice(0, 16)
end
