defmodule Situ.Studio.Web.Dataset.Dialogs do
  @moduledoc false
  # The dialogs of a dataset's page: for a name, for recordings to add, for a task's options.
  use Situ.Live.Component
  alias Situ.Studio.Web.Dataset.BatchDialog

  attr(:dialog, :any, required: true)

  @doc false
  def dialog(%{dialog: {:ask, _, _, _}} = assigns) do
    {:ask, what, path, old} = assigns.dialog
    assigns = assign(assigns, title: title(what, path), old: old)

    ~H"""
    <dialog id="ask" phx-hook="Modal" aria-label={@title}>
      <form id="ask-form" phx-submit="answer">
        <h3>{@title}</h3>
        <input name="text" value={@old} aria-label="Name" maxlength="200" autocomplete="off" required autofocus>
        <div class="choices">
          <button class="btn primary" type="submit">OK</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
      </form>
    </dialog>
    """
  end

  def dialog(%{dialog: {:recordings, _, _}} = assigns) do
    {:recordings, path, free} = assigns.dialog
    assigns = assign(assigns, path: path, free: free)

    ~H"""
    <dialog id="recordings" phx-hook="Modal" aria-label="Add recordings">
      <form id="recordings-form" phx-submit="add_recordings">
        <h3>{if @path == [], do: "Add recordings, each as a session", else: "Add recordings to #{hd(@path)}"}</h3>
        <div class="pick">
          <label :for={{id, _} <- @free}><input type="checkbox" name={"chosen[#{id}]"} value="true"> {id}</label>
          <p :if={@free == []} class="hint">Every recording of this folder is in the dataset already.</p>
        </div>
        <div class="choices">
          <button :if={@free != []} class="btn primary" type="submit">Add</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
      </form>
    </dialog>
    """
  end

  def dialog(%{dialog: {:task, _}} = assigns), do: BatchDialog.dialog(assigns)

  defp title("session", _), do: "New session"
  defp title("rename", path), do: "Rename #{List.last(path)}"
end
