defmodule Situ.Studio.Web.TierDialog do
  @moduledoc false
  # The dialog that edits the tiers of the layer that is open. Each button is one operation on the layer, which can be
  # undone, so the dialog has no draft.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2]

  alias Situ.Annotation.{Editor, Layer, Schema, Tier, TierEdit}
  alias Situ.Error
  alias Situ.Live.Socket

  @longest 2_000

  @doc "Handles the events of the dialog. The parameters are untrusted."
  @spec handle_event(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_event("annotation_tiers", _params, %{assigns: %{annotation: %{}}} = socket),
    do: show_tiers(socket, %{})

  def handle_event("annotation_tiers_undo", _params, %{assigns: %{annotation: %{}}} = socket),
    do: socket.assigns.annotation.editor |> Editor.undo() |> show_result(socket, nil)

  def handle_event("annotation_tiers_" <> name, params, %{assigns: %{annotation: %{}}} = socket) do
    tier = text_param(params, "tier")

    socket.assigns.annotation.editor
    |> Editor.edit_schema(&edit_layer(name, &1, tier, params))
    |> show_result(socket, tier)
  end

  def handle_event(_event, _params, socket), do: socket

  defp edit_layer("add", layer, _tier, params),
    do: TierEdit.add_tier(layer, text_param(params, "line"))

  defp edit_layer("remove", layer, tier, params),
    do: TierEdit.remove_tier(layer, tier, delete: params["delete"] == "true")

  defp edit_layer("up", layer, tier, _params) do
    case layer |> list_siblings(tier) |> Enum.split_while(&(&1 != tier)) do
      {[_ | _] = before, _} -> TierEdit.move_tier(layer, tier, List.last(before))
      _ -> {:ok, layer}
    end
  end

  defp edit_layer("down", layer, tier, _params) do
    case layer |> list_siblings(tier) |> Enum.split_while(&(&1 != tier)) do
      {_, [_, next | _]} -> TierEdit.move_tier(layer, next, tier)
      _ -> {:ok, layer}
    end
  end

  # One form changes everything about a tier, as one operation. Fields that were not changed are left alone.
  defp edit_layer("change", layer, tier, params) do
    name = params |> text_param("name") |> String.trim()

    with {:ok, old} <- find_tier(layer, tier),
         {:ok, layer} <- change_values(layer, tier, text_param(params, "values")),
         {:ok, layer} <- change_parent(layer, old, params),
         do: if(name == "", do: {:ok, layer}, else: TierEdit.rename_tier(layer, tier, name))
  end

  defp edit_layer(_name, layer, _tier, _params), do: {:ok, layer}

  defp find_tier(layer, name) do
    case Enum.find(layer.schema.tiers, &(&1.name == name)) do
      nil -> {:error, Error.new(:no_tier, "there is no tier #{inspect(name)} any more")}
      tier -> {:ok, tier}
    end
  end

  defp change_values(layer, tier, text) do
    if editable_values?(layer.schema, tier) and text != values_text(layer.schema, tier),
      do: TierEdit.change_values(layer, tier, text),
      else: {:ok, layer}
  end

  defp change_parent(layer, old, params) do
    {parent, relation} =
      case {text_param(params, "parent"), Tier.relations()[params["relation"]]} do
        {parent, relation} when parent == "" or relation == nil -> {nil, nil}
        both -> both
      end

    if {parent, relation} == {old.parent, old.relation},
      do: {:ok, layer},
      else: TierEdit.change_parent(layer, old.name, parent, relation)
  end

  defp list_siblings(layer, name) do
    parent = Enum.find_value(layer.schema.tiers, &(&1.name == name && {:of, &1.parent}))
    for tier <- layer.schema.tiers, {:of, tier.parent} == parent, do: tier.name
  end

  defp text_param(params, key) do
    case params[key] do
      text when is_binary(text) -> String.slice(text, 0, @longest)
      _ -> ""
    end
  end

  defp show_result({:ok, _layer}, socket, _tier),
    do: show_tiers(socket, %{})

  defp show_result({:error, error}, socket, tier) do
    ask = if error.code == :tier_in_use, do: tier
    show_tiers(socket, %{error: Exception.message(error), ask: ask})
  end

  defp show_tiers(socket, more) do
    layer = Editor.current_layer(socket.assigns.annotation.editor)
    rows = layer.schema.tiers |> order_tiers(nil, 0) |> Enum.map(&describe_row(layer, &1))
    ask = more[:ask] && {more.ask, TierEdit.count_dependents(layer, more.ask)}
    assign(socket, dialog: {:tiers, %{rows: rows, error: more[:error], ask: ask}})
  end

  defp order_tiers(tiers, parent, depth) do
    for tier <- tiers,
        tier.parent == parent,
        one <- [{tier, depth} | order_tiers(tiers, tier.name, depth + 1)],
        do: one
  end

  defp describe_row(layer, {tier, depth}) do
    siblings = list_siblings(layer, tier.name)

    %{
      name: tier.name,
      depth: depth,
      parent: tier.parent,
      relation: tier.relation && Atom.to_string(tier.relation),
      values: values_text(layer.schema, tier.name),
      values?: editable_values?(layer.schema, tier.name),
      annotations: count_annotations(layer, tier.name),
      first?: hd(siblings) == tier.name,
      last?: List.last(siblings) == tier.name
    }
  end

  defp count_annotations(layer, name) do
    for track <- Layer.track_names(layer),
        track == name or String.starts_with?(track, name <> "@"),
        reduce: 0,
        do: (n -> n + length(Layer.on_track(layer, track)))
  end

  # Numbers and yes or no have no vocabulary.
  defp editable_values?(schema, name), do: find_attribute(schema, name).kind in [:finite, :text]

  defp values_text(schema, name),
    do: schema |> find_attribute(name) |> Map.fetch!(:values) |> Enum.map_join(", ", & &1.value)

  defp find_attribute(schema, name),
    do: Schema.find_attribute(schema, Schema.find_tier(schema, name).attribute)

  attr(:rows, :list, required: true)
  attr(:error, :any, required: true)
  attr(:ask, :any, required: true)

  @doc false
  def dialog(assigns) do
    ~H"""
    <dialog id="tier-dialog" class="task" phx-hook="Modal" aria-label="Tiers of the annotations">
      <h3>Tiers</h3>
      <p :if={@rows == []} class="hint">This layer has no tiers yet: its tracks do not depend on each other.</p>
      <form :for={row <- @rows} :key={row.name} id={"tier-" <> row.name} class="schema-row tier-row"
          phx-submit="annotation_tiers_change" style={"margin-left: #{row.depth * 18}px"}>
        <input type="hidden" name="tier" value={row.name}>
        <input name="name" value={row.name} aria-label={"Name of " <> row.name} maxlength="100" autocomplete="off"
            required>
        <select name="relation" aria-label={"Relation of " <> row.name}>
          <option :for={{value, title} <- relations()} value={value}
              selected={value == (row.relation || "")}>{title}</option>
        </select>
        <select name="parent" aria-label={"Parent of " <> row.name}>
          <option value=""></option>
          <option :for={other <- @rows} :if={other.name != row.name} value={other.name}
              selected={other.name == row.parent}>{other.name}</option>
        </select>
        <input name="values" value={row.values} disabled={not row.values?} aria-label={"Values of " <> row.name}
            placeholder="texts, or values: noun, verb"
            title="Values with commas; old -> new renames one" autocomplete="off">
        <small title="Annotations on this tier">{row.annotations}</small>
        <button class="btn" type="submit" aria-label={"Change " <> row.name}>Change</button>
        <button class="btn" type="button" disabled={row.first?} phx-click="annotation_tiers_up"
            phx-value-tier={row.name} aria-label={"Move " <> row.name <> " up"}>↑</button>
        <button class="btn" type="button" disabled={row.last?} phx-click="annotation_tiers_down"
            phx-value-tier={row.name} aria-label={"Move " <> row.name <> " down"}>↓</button>
        <button class="btn" type="button" phx-click="annotation_tiers_remove" phx-value-tier={row.name}
            aria-label={"Remove " <> row.name} title="Remove the tier">×</button>
      </form>
      <form :for={n <- [length(@rows)]} :key={n} id={"tier-add-#{n}"} data-form="tier-add"
          class="schema-row" phx-submit="annotation_tiers_add">
        <input name="line" aria-label="New tier" placeholder="Kind of Words: noun, verb" autocomplete="off"
            maxlength="1000" required>
        <button class="btn" type="submit">Add tier</button>
      </form>
      <div class="error" role="alert">{@error}</div>
      <div class="choices">
        <button :if={@ask} class="btn" type="button" phx-click="annotation_tiers_remove"
            phx-value-tier={elem(@ask, 0)} phx-value-delete="true">{ask_text(@ask)}</button>
        <button class="btn" type="button" phx-click="annotation_tiers_undo">Undo</button>
        <button class="btn primary" type="button" phx-click="dialog_close">Close</button>
      </div>
      <p class="hint">A new tier is one line: <i>Words in Utterance</i> is inside, <i>Turns divides Utterance</i>,
        <i>Parts parts of Words</i> divides into equal parts, <i>English of Utterance</i> is one for each. Every change
        applies to the annotations at once, and can be undone.</p>
    </dialog>
    """
  end

  defp ask_text({name, %{tiers: 0, annotations: n}}),
    do: "Remove #{name} and #{count_text(n, "annotation")}"

  defp ask_text({name, %{tiers: tiers, annotations: n}}),
    do:
      "Remove #{name}, #{count_text(tiers, "tier")} below it, and #{count_text(n, "annotation")}"

  defp count_text(1, word), do: "1 #{word}"
  defp count_text(n, word), do: "#{n} #{word}s"

  defp relations,
    do: [
      {"", "on its own"},
      {"included_in", "inside"},
      {"time_subdivision", "divides"},
      {"symbolic_subdivision", "equal parts of"},
      {"symbolic_association", "one for each of"}
    ]
end
