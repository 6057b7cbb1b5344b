defmodule Situ.Studio.Web.SchemaDialog do
  @moduledoc false
  # Renders the dialog that edits an annotation schema: attributes and their values, each with a key and a color.
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
              <option :for={{kind, title} <- attribute_kinds()}
                  value={kind} selected={kind == a.kind}>{title}</option></select>
            <button class="btn" type="button" phx-click="annotation_row" phx-value-do="remove" phx-value-at={i}
                aria-label={"Remove " <> a.name} title="Remove it from the schema and all annotations">×</button>
          </div>
          <div :for={{v, k} <- Enum.with_index(a.values)} :if={a.kind == "finite"} :key={k} class="schema-row value">
            <input name={"attribute[#{i}][values][#{k}][value]"} value={v.value} aria-label="Value" placeholder="Value"
                autocomplete="off">
            <input name={"attribute[#{i}][values][#{k}][key]"} value={v.key} aria-label={"Key of " <> v.value}
                placeholder="Key" maxlength="1" autocomplete="off">
            <input type="color" name={"attribute[#{i}][values][#{k}][fill]"}
                value={fill_color(v, k, a.values)} aria-label={"Color of " <> v.value}>
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
          <button class="btn" type="button" phx-click="annotation_schema_keep"
              title="New annotations of other recordings can use this schema">Keep for other recordings</button>
        </div>
        <p class="hint">Renaming applies to every annotation. A value that annotations use cannot be
          removed.</p>
      </form>
    </dialog>
    """
  end

  # A color input always shows a color, so values without a color get different defaults.
  @usual ~w(#4ea1f3 #4cc38a #e0b13f #d670a5 #a78bfa #f2884a #56c7d1 #e06c75)

  defp fill_color(%{fill: ""}, nth, values) do
    free = @usual -- Enum.map(values, &String.downcase(&1.fill))
    before = values |> Enum.take(nth) |> Enum.count(&(&1.fill == ""))
    Enum.at(if(free == [], do: @usual, else: free), rem(before, max(length(free), 1)))
  end

  defp fill_color(%{fill: fill}, _, _), do: fill

  defp attribute_kinds,
    do: [
      {"finite", "list of values"},
      {"text", "text"},
      {"number", "number"},
      {"bool", "yes or no"}
    ]
end
