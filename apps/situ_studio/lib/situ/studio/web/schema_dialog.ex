defmodule Situ.Studio.Web.SchemaDialog do
  @moduledoc false
  # Editing the schema of annotations: attributes and their values, each with key and colour.
  use Situ.Live.Component

  attr(:draft, :list, required: true)
  attr(:error, :any, required: true)

  @doc false
  def dialog(assigns) do
    ~H"""
    <dialog id="schema-dialog" class="task" phx-hook="Modal" aria-label="Schema of the annotations">
      <h3>Attributes and values</h3>
      <form id="schema" phx-change="annotation_draft" phx-submit="annotation_schema_save">
        <fieldset :for={{a, i} <- Enum.with_index(@draft)} :key={i}>
          <legend>Attribute {i + 1}</legend>
          <div class="schema-row">
            <input name={"attribute[#{i}][name]"} value={a.name} aria-label="Name of the attribute"
                placeholder="Name" autocomplete="off">
            <select name={"attribute[#{i}][kind]"} aria-label={"Kind of " <> a.name}>
              <option :for={{kind, title} <- kinds()} value={kind} selected={kind == a.kind}>{title}</option></select>
            <button class="btn" type="button" phx-click="annotation_row" phx-value-do="remove" phx-value-at={i}
                aria-label={"Remove " <> a.name} title="Remove it, also from all annotations">×</button>
          </div>
          <div :for={{v, k} <- Enum.with_index(a.values)} :if={a.kind == "finite"} :key={k} class="schema-row value">
            <input name={"attribute[#{i}][values][#{k}][value]"} value={v.value} aria-label="Value" placeholder="Value"
                autocomplete="off">
            <input name={"attribute[#{i}][values][#{k}][key]"} value={v.key} aria-label={"Key of " <> v.value}
                placeholder="Key" maxlength="1" autocomplete="off">
            <input type="color" name={"attribute[#{i}][values][#{k}][fill]"}
                value={if v.fill == "", do: "#4ea1f3", else: v.fill} aria-label={"Colour of " <> v.value}>
            <button class="btn" type="button" phx-click="annotation_row" phx-value-do="remove" phx-value-at={i}
                phx-value-nth={k} aria-label={"Remove " <> v.value}>×</button>
          </div>
          <button :if={a.kind == "finite"} class="btn" type="button" phx-click="annotation_row" phx-value-do="add"
              phx-value-at={i}>Another value</button>
        </fieldset>
        <div class="choices">
          <button class="btn" type="button" phx-click="annotation_row"
              phx-value-do="attribute">Another attribute</button>
        </div>
        <div class="error" role="alert">{@error}</div>
        <div class="choices">
          <button class="btn primary" type="submit">Save</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
        <p class="hint">A new name applies to every annotation. A value that annotations have cannot be
          removed.</p>
      </form>
    </dialog>
    """
  end

  defp kinds,
    do: [
      {"finite", "one of these"},
      {"text", "text"},
      {"number", "number"},
      {"bool", "yes or no"}
    ]
end
