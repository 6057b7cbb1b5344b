defmodule Situ.Studio.Web.AnnotationDialog do
  @moduledoc false
  # Renders the dialog that opens or creates an annotation stream.
  use Situ.Live.Component

  attr(:streams, :list, required: true)
  attr(:schemas, :list, required: true)

  @doc false
  def dialog(assigns) do
    ~H"""
    <dialog id="annotation-dialog" phx-hook="Modal" phx-update="ignore" aria-label="Annotate">
      <h3>Annotate</h3>
      <div :if={@streams != []} class="choices">
        <button :for={s <- @streams} class="btn" type="button" phx-click="annotation_open"
            phx-value-stream={s}>{s}</button>
      </div>
      <form id="annotation-new" phx-submit="annotation_new">
        <label>New annotations <input name="name" placeholder="Speech" autocomplete="off" maxlength="60"
            required autofocus></label>
        <label>Values, one per line: name, key, color
          <textarea name="values" rows="4" placeholder={"speaks 1 #4ea1f3\nlaughs 2"}></textarea></label>
        <div class="inline">
          <select name="kind" aria-label="Kind of annotation"><option value="values">Segments in time</option><option
              value="box">Boxes on images</option><option value="point">Points on images</option></select>
          <input name="by" placeholder="annotator (optional)" maxlength="40" autocomplete="off"
              aria-label="Annotator">
          <select :if={@schemas != []} name="schema" aria-label="Schema"><option
              value="">Use the values above</option><option
              :for={s <- @schemas} value={s}>Schema {s}</option></select>
        </div>
        <div class="choices">
          <button class="btn primary" type="submit">Annotate</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
        <p class="hint">Annotations are saved next to the recording, which is never modified. Every edit is saved
          immediately.</p>
      </form>
      <form :if={@streams != []} id="annotation-own" class="inline" phx-submit="annotation_own">
        <select name="stream" aria-label="Annotations whose schema is used"><option
            :for={s <- @streams} value={s}>{s}</option></select>
        <input name="by" placeholder="your name" maxlength="40" autocomplete="off" required
            aria-label="Your name, for a separate layer">
        <button class="btn" type="submit">Add my own layer</button>
      </form>
    </dialog>
    """
  end
end
