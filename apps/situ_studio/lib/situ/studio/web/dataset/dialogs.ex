defmodule Situ.Studio.Web.Dataset.Dialogs do
  @moduledoc false
  # Renders the dialogs of a dataset's page: entering a name, adding recordings or folders, replacing and exporting a
  # recording, and running a task.
  use Situ.Live.Component
  alias Situ.Studio.Web.Dataset.BatchDialog

  attr(:dialog, :any, required: true)

  @doc false
  def dataset_dialog(%{dialog: {:ask, _, _, _}} = assigns) do
    {:ask, what, path, old} = assigns.dialog
    assigns = assign(assigns, title: dialog_title(what, path), old: old)

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

  def dataset_dialog(%{dialog: {:recordings, _, _}} = assigns) do
    {:recordings, path, free} = assigns.dialog
    assigns = assign(assigns, path: path, free: free)

    ~H"""
    <dialog id="recordings" phx-hook="Modal" aria-label="Add recordings">
      <form id="recordings-form" phx-submit="add_recordings">
        <h3>{if @path == [], do: "Add recordings, each as a session", else: "Add recordings to #{hd(@path)}"}</h3>
        <div class="pick">
          <label :for={{id, _} <- @free}><input type="checkbox" name={"chosen[#{id}]"} value="true"> {id}</label>
          <p :if={@free == []} class="hint">Every recording in this folder is already in the dataset.</p>
        </div>
        <div class="choices">
          <button :if={@free != []} class="btn primary" type="submit">Add</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
      </form>
    </dialog>
    """
  end

  def dataset_dialog(%{dialog: {:relocate, _, _}} = assigns) do
    {:relocate, path, free} = assigns.dialog
    assigns = assign(assigns, title: "Use another recording for #{List.last(path)}", free: free)

    ~H"""
    <dialog id="relocate" phx-hook="Modal" aria-label={@title}>
      <form id="relocate-form" phx-submit="take">
        <h3>{@title}</h3>
        <p class="hint">Use this if a recording was moved or renamed. Name and metadata stay the same.</p>
        <div class="pick">
          <label :for={{id, _} <- @free}><input type="radio" name="chosen" value={id} required> {id}</label>
          <p :if={@free == []} class="hint">Every recording in this folder is already in the dataset.</p>
        </div>
        <div class="choices">
          <button :if={@free != []} class="btn primary" type="submit">Use it</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
      </form>
    </dialog>
    """
  end

  def dataset_dialog(%{dialog: {:folders, _, _, _}} = assigns) do
    {:folders, what, path, folders} = assigns.dialog

    assigns =
      assign(assigns, title: folder_title(what, path), about: folder_hint(what), folders: folders)

    ~H"""
    <dialog id="folders" phx-hook="Modal" aria-label={@title}>
      <form id="folders-form" phx-submit="add_folder">
        <h3>{@title}</h3>
        <p class="hint">{@about}</p>
        <div class="pick">
          <label :for={{id, _} <- @folders}><input type="radio" name="folder" value={id} required>
            {if id == ".", do: "the studio's own folder", else: id}</label>
          <p :if={@folders == []} class="hint">No folder here contains recordings.</p>
        </div>
        <div class="choices">
          <button :if={@folders != []} class="btn primary" type="submit">Add</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
      </form>
    </dialog>
    """
  end

  def dataset_dialog(%{dialog: {:export, _, _}} = assigns) do
    {:export, item, facts} = assigns.dialog

    assigns =
      assign(assigns,
        item: item,
        length: Situ.Time.format_duration(facts.to - facts.from),
        seconds: (facts.to - facts.from) / 1.0e9
      )

    ~H"""
    <dialog id="part" phx-hook="Modal" aria-label="Save a section as a recording">
      <form id="part-form" phx-submit="save_part">
        <h3>Save a section of {@item.title} as a recording</h3>
        <p class="hint">This recording lasts {@length} and is not modified. The copy is written to
          {Path.dirname(@item.path)}.</p>
        <label>Name <input name="name" value={String.slice(@item.title, 0, 50) <> " part"} maxlength="60"
            autocomplete="off" required autofocus></label>
        <label>From (seconds after the start, or a time) <input name="from" value="0"
            autocomplete="off"></label>
        <label>To <input name="to" value={@seconds} autocomplete="off"></label>
        <div class="choices">
          <button class="btn primary" type="submit">Save</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
      </form>
    </dialog>
    """
  end

  def dataset_dialog(%{dialog: {:task, _}} = assigns), do: BatchDialog.run_dialog(assigns)

  defp folder_title("session", _), do: "Add a folder as one session"
  defp folder_title("sessions", _), do: "Add each subfolder of a folder as a session"

  defp folder_title("recordings", [session | _]),
    do: "Add all recordings of a folder to #{session}"

  defp folder_hint("session"),
    do: "All recordings in the folder and its subfolders are added to the session."

  defp folder_hint("sessions"), do: "Sessions that are already in the dataset are skipped."
  defp folder_hint("recordings"), do: "Recordings that are already in the session are skipped."

  defp dialog_title("session", _), do: "New session"
  defp dialog_title("copy", _), do: "Save a copy of the dataset as"
  defp dialog_title("rename", path), do: "Rename #{List.last(path)}"
end
