defmodule Situ.Annotation.TierEdit do
  @moduledoc """
  Edits the tiers of a layer that has annotations: adds, renames, moves and removes tiers, and changes their relations
  and vocabularies. Annotations follow, or the edit is refused.

      iex> alias Situ.Annotation.{Editor, Layer, Schema, TierEdit}
      iex> path = Path.join(System.tmp_dir!(), "situ-doc-tier-edit/annotation")
      iex> {:ok, editor} = Editor.start_link(path: path, stream: "Speech", schema: Schema.text("Notes"))
      iex> {:ok, _} = Editor.edit_schema(editor, &TierEdit.add_tier(&1, "Utterance"))
      iex> {:ok, _} = Editor.edit_schema(editor, &TierEdit.add_tier(&1, "Kind of Utterance: question, answer"))
      iex> {:ok, _} = Editor.edit(editor, &Layer.add(&1, Situ.Annotation.new(0, 9, "Utterance")))
      iex> {:ok, _} = Editor.edit(editor, &Layer.add(&1, Situ.Annotation.new(0, 9, "Kind")))
      iex> {:ok, layer} = Editor.edit_schema(editor, &TierEdit.rename_tier(&1, "Kind", "Act"))
      iex> for a <- Layer.on_track(layer, "Act"), do: a.values
      [%{"Act" => "question"}]
      iex> {:error, error} = Editor.edit_schema(editor, &TierEdit.remove_tier(&1, "Utterance"))
      iex> error.why
      "tier \\"Utterance\\" has the tier \\"Act\\" below it and 2 annotations"
      iex> {:ok, layer} = Editor.undo(editor)
      iex> Layer.track_names(layer)
      ["Kind", "Utterance"]
      iex> File.rm_rf!(Path.dirname(path)) != []
      true

  The functions take a layer and return `{:ok, layer}`, for `Situ.Annotation.Editor.edit_schema/3`. A tier is described
  by a line: `Words` has no parent, `Words in Utterance` is inside its annotations, `Turns divides Utterance` divides
  their time, `Parts parts of Words` divides them into equal parts, and `English of Utterance` is one annotation for
  each. Values after a colon are a vocabulary; without them, the annotations have texts.
  """
  # See docs/adr/0206-tiers-are-edited-as-one-operation.md.
  alias Situ.Annotation.{Layer, Schema, Tier, TierText}
  alias Situ.Error

  @type edited :: {:ok, Layer.t()} | {:error, Error.t()}

  @doc """
  Adds a tier after the others. If the schema has an attribute of that name, the tier uses it. Errors: `:tier_exists`,
  `:bad_schema`, and `:bad_tier_edit` if annotations of a track of that name do not fit.
  """
  @spec add_tier(Layer.t(), String.t()) :: edited()
  def add_tier(%Layer{schema: schema} = layer, line) do
    {attribute, tier} = TierText.parse_tier(line)
    json = Schema.to_json(schema)

    attributes =
      if Schema.find_attribute(schema, tier["name"]) && attribute["values"] == nil,
        do: json["attributes"],
        else: json["attributes"] ++ [attribute]

    with :ok <- check_free(schema, tier["name"]),
         do: rebuild_layer(layer, {attributes, list_json(json) ++ [tier]})
  end

  defp check_free(schema, name) do
    if Enum.any?(schema.tiers, &(&1.name == name)),
      do:
        {:error,
         Error.new(:tier_exists, "there already is a tier #{inspect(name)}",
           fix: "choose another name"
         )},
      else: :ok
  end

  @doc """
  Renames a tier, the tracks of all persons, and its attribute, unless other tiers use that. Errors: `:no_tier`,
  `:tier_exists`, and `:track_exists` if there are tracks with the new name.
  """
  @spec rename_tier(Layer.t(), String.t(), String.t()) :: edited()
  def rename_tier(layer, name, name),
    do: with({:ok, _} <- fetch_tier(layer, name), do: {:ok, layer})

  def rename_tier(%Layer{schema: schema} = layer, from, to) do
    with {:ok, tier} <- fetch_tier(layer, from),
         :ok <- check_free(schema, to),
         :ok <- check_tracks(layer, to) do
      json = Schema.to_json(schema)
      attribute = if own_attribute?(schema, tier, to), do: to, else: tier.attribute

      attributes =
        for a <- json["attributes"], do: replace_field(a, "name", tier.attribute, attribute)

      tiers =
        for t <- list_json(json) do
          t
          |> replace_field("name", from, to)
          |> replace_field("parent", from, to)
          |> replace_field("attribute", tier.attribute, attribute)
        end

      rebuild_layer(layer, {attributes, tiers}, fn a ->
        track =
          if track_of_tier?(layer, a.track, from),
            do: String.replace_prefix(a.track, from, to),
            else: a.track

        %{a | track: track, values: rename_key(a.values, tier.attribute, attribute)}
      end)
    end
  end

  # An attribute is renamed with its tier if it has the tier's name and no other tier uses it.
  defp own_attribute?(schema, tier, to) do
    tier.attribute == tier.name and Schema.find_attribute(schema, to) == nil and
      Enum.count(schema.tiers, &(&1.attribute == tier.attribute)) == 1
  end

  defp check_tracks(layer, name) do
    case Enum.find(
           Layer.track_names(layer),
           &(&1 == name or String.starts_with?(&1, name <> "@"))
         ) do
      nil ->
        :ok

      track ->
        {:error,
         Error.new(:track_exists, "the tier cannot be named #{inspect(name)}",
           why: "there already is a track #{inspect(track)} with annotations",
           fix: "rename that track first, or choose another name"
         )}
    end
  end

  @doc """
  Removes a tier. If it has annotations or tiers below it, this is refused, unless `delete: true` says to remove them,
  too. Its attribute is removed if nothing else uses it. Errors: `:no_tier`, `:tier_in_use`.
  """
  @spec remove_tier(Layer.t(), String.t(), keyword()) :: edited()
  def remove_tier(%Layer{schema: schema} = layer, name, opts \\ []) do
    with {:ok, tier} <- fetch_tier(layer, name),
         below = list_below(schema.tiers, name),
         gone = [tier | below],
         lost = Enum.filter(Layer.annotations(layer), &on_tiers?(layer, &1.track, gone)),
         :ok <- check_unused(tier, below, {lost, opts[:delete] == true}) do
      json = Schema.to_json(schema)
      names = Enum.map(gone, & &1.name)
      tiers = Enum.reject(list_json(json), &(&1["name"] in names))
      kept = Layer.annotations(layer) -- lost
      unused = unused_attributes(gone, tiers, kept)

      attributes =
        case Enum.reject(json["attributes"], &(&1["name"] in unused)) do
          [] -> json["attributes"]
          attributes -> attributes
        end

      rebuild_layer(%{layer | by_id: Map.new(kept, &{&1.id, &1})}, {attributes, tiers})
    end
  end

  @doc "Counts what `remove_tier/3` with `delete: true` removes besides the tier: tiers below it, and annotations."
  @spec count_dependents(Layer.t(), String.t()) :: %{
          tiers: non_neg_integer(),
          annotations: non_neg_integer()
        }
  def count_dependents(%Layer{schema: schema} = layer, name) do
    below = list_below(schema.tiers, name)
    gone = Enum.filter(schema.tiers, &(&1.name == name)) ++ below
    lost = Enum.count(Layer.annotations(layer), &on_tiers?(layer, &1.track, gone))
    %{tiers: length(below), annotations: lost}
  end

  @doc "Describes a tier in one line, as `add_tier/2` reads it; the values of a vocabulary are included."
  @spec describe_tier(Schema.t(), String.t()) :: String.t()
  def describe_tier(%Schema{} = schema, name) do
    %Tier{} = tier = Enum.find(schema.tiers, &(&1.name == name))
    line = TierText.format_tier(tier)

    case Schema.find_attribute(schema, tier.attribute).values do
      [] -> line
      values -> "#{line}: #{Enum.map_join(values, ", ", & &1.value)}"
    end
  end

  defp list_below(tiers, name) do
    for tier <- tiers, tier.parent == name, one <- [tier | list_below(tiers, tier.name)], do: one
  end

  defp on_tiers?(layer, track, tiers),
    do: Enum.any?(tiers, &track_of_tier?(layer, track, &1.name))

  defp check_unused(_tier, [], {[], _delete?}), do: :ok
  defp check_unused(_tier, _below, {_lost, true}), do: :ok

  defp check_unused(tier, below, {lost, false}) do
    tiers =
      case below do
        [] -> nil
        [one] -> "the tier #{inspect(one.name)} below it"
        several -> "the tiers #{Enum.map_join(several, ", ", &inspect(&1.name))} below it"
      end

    annotations =
      case length(lost) do
        0 -> nil
        1 -> "1 annotation"
        n -> "#{n} annotations"
      end

    {:error,
     Error.new(:tier_in_use, "the tier #{inspect(tier.name)} cannot be removed",
       why:
         "tier #{inspect(tier.name)} has " <>
           Enum.join(Enum.reject([tiers, annotations], &is_nil/1), " and "),
       fix: "remove them first, or say that they are deleted with it; that can be undone"
     )}
  end

  defp unused_attributes(gone, tiers, kept) do
    for %{attribute: name} <- gone,
        not Enum.any?(tiers, &(&1["attribute"] == name)),
        not Enum.any?(kept, &is_map_key(&1.values, name)),
        uniq: true,
        do: name
  end

  @doc """
  Moves a tier before another one, or after all others (`nil`). Children are shown below their parents, so the order of
  the tiers of one parent matters. Error: `:no_tier`.
  """
  @spec move_tier(Layer.t(), String.t(), String.t() | nil) :: edited()
  def move_tier(layer, name, name),
    do: with({:ok, _} <- fetch_tier(layer, name), do: {:ok, layer})

  def move_tier(%Layer{schema: schema} = layer, name, before) do
    with {:ok, _} <- fetch_tier(layer, name),
         {:ok, _} <- if(before, do: fetch_tier(layer, before), else: {:ok, nil}) do
      json = Schema.to_json(schema)
      {[tier], others} = Enum.split_with(list_json(json), &(&1["name"] == name))
      {first, last} = Enum.split_while(others, &(&1["name"] != before))
      rebuild_layer(layer, {json["attributes"], first ++ [tier | last]})
    end
  end

  @doc """
  Changes the parent and the relation (`Situ.Annotation.Schema`) of a tier; `nil` and `nil` for a tier without a parent.
  Errors: `:no_tier`, `:bad_schema`, and `:bad_tier_edit` if its annotations do not fit.
  """
  @spec change_parent(Layer.t(), String.t(), String.t() | nil, atom()) :: edited()
  def change_parent(%Layer{schema: schema} = layer, name, parent, relation) do
    with {:ok, _} <- fetch_tier(layer, name) do
      json = Schema.to_json(schema)
      fields = %{"parent" => parent, "relation" => relation && Atom.to_string(relation)}

      tiers =
        for t <- list_json(json), do: if(t["name"] == name, do: Map.merge(t, fields), else: t)

      rebuild_layer(layer, {json["attributes"], tiers})
    end
  end

  @doc "Changes the parent and the relation of a tier by a line, such as `\"Words divides Utterance\"`."
  @spec change_parent(Layer.t(), String.t()) :: edited()
  def change_parent(%Layer{} = layer, line) do
    {_, tier} = TierText.parse_tier(line)
    change_parent(layer, tier["name"], tier["parent"], Tier.relations()[tier["relation"]])
  end

  @doc """
  Changes the vocabulary of a tier, as `"noun, verb, adj -> adjective"`: the values in this order. `old -> new` renames
  a value, also in annotations. An empty text means free text. Other tiers with the same attribute get it, too. Errors:
  `:no_tier`, `:bad_schema`, and `:value_in_use` if annotations have a value that is missing.
  """
  @spec change_values(Layer.t(), String.t(), String.t()) :: edited()
  def change_values(%Layer{schema: schema} = layer, name, text) do
    with {:ok, tier} <- fetch_tier(layer, name) do
      json = Schema.to_json(schema)
      old = Enum.find(json["attributes"], &(&1["name"] == tier.attribute))
      pairs = text |> TierText.split_values() |> Enum.map(&parse_rename/1)
      renames = for {was, value} <- pairs, was != value, into: %{}, do: {was, value}
      rename = &rename_value(&1, tier.attribute, renames)

      with :ok <- check_values(layer, tier, {pairs, rename}) do
        attribute = build_attribute(old, pairs)

        attributes =
          for a <- json["attributes"], do: if(a["name"] == tier.attribute, do: attribute, else: a)

        rebuild_layer(layer, {attributes, list_json(json)}, rename)
      end
    end
  end

  defp parse_rename(text) do
    case String.split(text, "->", parts: 2) do
      [was, value] -> {String.trim(was), String.trim(value)}
      [value] -> {value, value}
    end
  end

  defp rename_value(annotation, attribute, renames) do
    case annotation.values do
      %{^attribute => value} when is_map_key(renames, value) ->
        %{annotation | values: Map.put(annotation.values, attribute, renames[value])}

      _ ->
        annotation
    end
  end

  # Values keep their keys, colors and descriptions.
  defp build_attribute(old, []),
    do: old |> Map.take(["name", "description"]) |> Map.put("kind", "text")

  defp build_attribute(old, pairs) do
    known = Map.new(old["values"] || [], &{&1["value"], &1})

    values =
      for {was, value} <- pairs,
          do: known |> Map.get(was, %{}) |> Map.put("value", value)

    old
    |> Map.take(["name", "description"])
    |> Map.merge(%{"kind" => "finite", "values" => values})
  end

  defp check_values(_layer, _tier, {[], _rename}), do: :ok

  defp check_values(layer, tier, {pairs, rename}) do
    allowed = Enum.map(pairs, &elem(&1, 1))

    missing =
      for a <- Layer.annotations(layer),
          {:ok, value} <- [Map.fetch(rename.(a).values, tier.attribute)],
          value not in allowed,
          do: to_string(value)

    if missing == [], do: :ok, else: {:error, value_error(tier, missing)}
  end

  defp value_error(tier, missing) do
    counts = missing |> Enum.frequencies() |> Enum.sort_by(fn {value, n} -> {-n, value} end)
    shown = counts |> Enum.take(5) |> Enum.map_join(", ", fn {v, n} -> "#{inspect(v)} (#{n})" end)
    more = if length(counts) > 5, do: " and #{length(counts) - 5} more", else: ""

    Error.new(:value_in_use, "the vocabulary of #{inspect(tier.name)} cannot be changed",
      why: "annotations have values that it lacks: #{shown}#{more}",
      fix: "keep them, or rename them with \"old -> new\""
    )
  end

  defp fetch_tier(layer, name) do
    case Enum.find(layer.schema.tiers, &(&1.name == name)) do
      %Tier{} = tier ->
        {:ok, tier}

      nil ->
        known = Enum.map_join(layer.schema.tiers, ", ", & &1.name)
        fix = if known == "", do: "the layer has no tiers; add one", else: "choose from: #{known}"
        {:error, Error.new(:no_tier, "there is no tier #{inspect(name)}", fix: fix)}
    end
  end

  # A track `TIER@PERSON` belongs to the tier `TIER`, unless a tier has its whole name.
  defp track_of_tier?(layer, track, name), do: base_name(layer, track) == name

  defp base_name(layer, track) do
    cond do
      Enum.any?(layer.schema.tiers, &(&1.name == track)) ->
        track

      tier = Schema.find_tier(layer.schema, track) ->
        String.replace_suffix(track, "@" <> tier.participant, "")

      true ->
        nil
    end
  end

  defp replace_field(json, field, from, to),
    do: if(json[field] == from, do: Map.put(json, field, to), else: json)

  defp rename_key(values, name, name), do: values

  defp rename_key(values, from, to) do
    case Map.pop(values, from) do
      {nil, values} -> values
      {value, values} -> Map.put(values, to, value)
    end
  end

  defp list_json(json), do: json["tiers"] || []

  defp rebuild_layer(layer, {attributes, tiers}, fun \\ & &1) do
    json =
      layer.schema
      |> Schema.to_json()
      |> Map.merge(%{"attributes" => attributes, "tiers" => tiers})

    with {:ok, schema} <- Schema.parse(json),
         annotations = layer |> Layer.annotations() |> Enum.map(fun),
         {:ok, new} <- Layer.new(schema, annotations, layer.review) do
      {:ok, %{new | next: max(new.next, layer.next)}}
    else
      {:error, %Error{code: :bad_schema} = error} ->
        {:error, %{error | fix: "see the tiers of this layer with `situ annotate info`"}}

      {:error, error} ->
        {:error,
         Error.new(:bad_tier_edit, "the tiers cannot be changed",
           why: Enum.join(Enum.reject([error.what, error.why], &(&1 in [nil, ""])), ": "),
           fix: "change these annotations first"
         )}
    end
  end
end
