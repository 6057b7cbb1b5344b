defmodule Situ.Annotation.Exchange.Elan.TierReader do
  @moduledoc false
  # Reads the tiers, types and vocabularies of an ELAN document. Annotations without times get them from their
  # parents: symbolic subdivisions get equal parts. Boundaries without a time are interpolated.
  alias Situ.Annotation.Schema
  alias Situ.Annotation.Exchange.Elan.TierWriter
  alias Situ.Xml

  @ms 1_000_000
  @relations Map.new(TierWriter.relation_words(), fn {relation, word} -> {word, relation} end)

  @type label :: {from :: integer(), to :: integer(), text :: String.t()}
  @typedoc "`rows` have times relative to the document; `missing` counts the annotations without times."
  @type document_rows :: %{
          rows: [{String.t(), [label()]}],
          missing: non_neg_integer(),
          interpolated: non_neg_integer()
        }

  @doc "Reads the labels of all tiers."
  @spec read_rows(Xml.element()) :: document_rows()
  def read_rows(document) do
    tiers = read_tiers(document)
    slots = read_slots(document)
    {slots, interpolated} = Enum.reduce(tiers, {slots, 0}, &fill_slots/2)
    spans = resolve_spans(tiers, slots)

    {rows, missing} =
      Enum.map_reduce(tiers, 0, fn tier, missing ->
        labels =
          for a <- tier.annotations,
              {from, to} <- [spans[a.id]],
              do: {from, max(from, to), a.text}

        {{tier.name, labels}, missing + length(tier.annotations) - length(labels)}
      end)

    %{rows: rows, missing: missing, interpolated: interpolated}
  end

  @doc "Returns the annotator of each tier that has one."
  @spec read_annotators(Xml.element()) :: %{String.t() => String.t()}
  def read_annotators(document) do
    for {_, %{"TIER_ID" => name, "ANNOTATOR" => by}, _} <- Xml.list_children(document, "TIER"),
        by != "",
        into: %{},
        do: {name, by}
  end

  defp read_tiers(document) do
    for {_, %{"TIER_ID" => name} = attributes, _} = tier <- Xml.list_children(document, "TIER") do
      %{
        name: name,
        type: attributes["LINGUISTIC_TYPE_REF"] || "",
        parent: attributes["PARENT_REF"],
        participant: attributes["PARTICIPANT"],
        annotations: read_annotations(tier)
      }
    end
  end

  defp read_annotations(tier) do
    for {_, _, inner} <- Xml.list_children(tier, "ANNOTATION"),
        {kind, attributes, _} = a <- inner do
      text = a |> Xml.list_children("ANNOTATION_VALUE") |> Enum.map_join(&Xml.text_content/1)

      %{
        id: attributes["ANNOTATION_ID"],
        text: text,
        parent: if(kind == "REF_ANNOTATION", do: attributes["ANNOTATION_REF"]),
        previous: attributes["PREVIOUS_ANNOTATION"],
        slots: {attributes["TIME_SLOT_REF1"], attributes["TIME_SLOT_REF2"]}
      }
    end
  end

  defp read_slots(document) do
    for order <- Xml.list_children(document, "TIME_ORDER"),
        {_, %{"TIME_SLOT_ID" => id} = attributes, _} <- Xml.list_children(order, "TIME_SLOT"),
        into: %{},
        do: {id, parse_ms(attributes["TIME_VALUE"])}
  end

  defp parse_ms(nil), do: nil

  defp parse_ms(text) do
    case Integer.parse(String.trim(text)) do
      {n, ""} -> n * @ms
      _ -> nil
    end
  end

  # Boundaries of a subdivision without a time are spread between the boundaries with a time.
  defp fill_slots(tier, {slots, count}) do
    chain =
      for(%{parent: nil, slots: {a, b}} <- tier.annotations, do: [a, b])
      |> Enum.concat()
      |> Enum.dedup()

    chain
    |> Enum.chunk_while({nil, []}, &chunk_unknown(&1, &2, slots), fn _ -> {:cont, nil} end)
    |> Enum.reduce({slots, count}, fn {from, unknown, to}, {slots, count} ->
      step = (to - from) / (length(unknown) + 1)

      filled =
        for {id, i} <- Enum.with_index(unknown, 1), into: slots, do: {id, from + round(i * step)}

      {filled, count + length(unknown)}
    end)
  end

  defp chunk_unknown(id, {from, unknown}, slots) do
    case {slots[id], from, unknown} do
      {nil, nil, _} ->
        {:cont, {nil, []}}

      {nil, from, unknown} ->
        {:cont, {from, [id | unknown]}}

      {time, _, []} ->
        {:cont, {time, []}}

      {time, from, unknown} when time >= from ->
        {:cont, {from, Enum.reverse(unknown), time}, {time, []}}

      {time, _, _} ->
        {:cont, {time, []}}
    end
  end

  # Annotations that refer to others get times level by level. A cycle of references ends without times.
  defp resolve_spans(tiers, slots) do
    aligned =
      for %{annotations: all} <- tiers,
          %{parent: nil, slots: {a, b}} = annotation <- all,
          is_integer(slots[a]) and is_integer(slots[b]),
          into: %{},
          do: {annotation.id, {slots[a], slots[b]}}

    families =
      for %{annotations: all} <- tiers, %{parent: parent} = a <- all, parent != nil, do: a

    resolve_level(Enum.group_by(families, & &1.parent), Map.keys(aligned), aligned)
  end

  defp resolve_level(_families, [], spans), do: spans

  defp resolve_level(families, parents, spans) do
    found =
      for id <- parents,
          family = families[id],
          {child, span} <- divide_span(family, spans[id]),
          not is_map_key(spans, child),
          into: %{},
          do: {child, span}

    resolve_level(families, Map.keys(found), Map.merge(spans, found))
  end

  # Several tiers can refer to one annotation. A chain of previous annotations divides it.
  defp divide_span(family, span) do
    {first, rest} = Enum.split_with(family, &(&1.previous == nil))
    next = Map.new(rest, &{&1.previous, &1})
    Enum.flat_map(first, &divide_chain(follow_chain(&1, next, length(rest)), span))
  end

  defp follow_chain(a, next, left) do
    case next[a.id] do
      later when later != nil and left > 0 -> [a | follow_chain(later, next, left - 1)]
      _ -> [a]
    end
  end

  defp divide_chain(chain, {from, to}) do
    count = length(chain)
    edge = &(from + div((to - from) * &1, count))
    for {a, i} <- Enum.with_index(chain), do: {a.id, {edge.(i), edge.(i + 1)}}
  end

  @doc """
  Returns the schema that the tiers of a document describe, or `nil` if they have neither parents nor vocabularies and
  one type: an attribute for each type in use, and all tiers.
  """
  @spec read_schema(Xml.element(), String.t()) :: Schema.t() | nil
  def read_schema(document, name) do
    tiers = read_tiers(document)
    types = read_types(document)
    used = tiers |> Enum.map(& &1.type) |> Enum.uniq()

    if Enum.any?(tiers, & &1.parent) or Enum.any?(used, &types[&1][:vocabulary]) or
         length(used) > 1 do
      case Schema.parse(schema_json(document, name, {tiers, types, used})) do
        {:ok, schema} -> schema
        {:error, _} -> nil
      end
    end
  end

  defp schema_json(document, name, {tiers, types, used}) do
    vocabularies = read_vocabularies(document)
    labels = for tier <- tiers, a <- tier.annotations, do: {tier.type, a.text}
    texts = Enum.group_by(labels, &elem(&1, 0), &elem(&1, 1))

    attributes =
      for type <- used,
          do: attribute_json(type, vocabularies[types[type][:vocabulary]], texts[type] || [])

    tiers =
      for tier <- tiers do
        parent = if tier.parent != tier.name, do: tier.parent

        %{
          "name" => tier.name,
          "attribute" => attribute_name(tier.type),
          "parent" => parent,
          "relation" => if(parent, do: types[tier.type][:relation] || "included_in"),
          "participant" => if(tier.participant not in [nil, ""], do: tier.participant)
        }
      end

    %{"name" => name, "attributes" => attributes, "tiers" => tiers}
  end

  defp attribute_name(""), do: "Value"
  defp attribute_name(type), do: type

  # Labels that are not in the vocabulary are kept as values, too. So is the empty label of a new annotation.
  defp attribute_json(type, [_ | _] = choices, texts) do
    known = Enum.map(choices, & &1["value"])
    others = for text <- Enum.uniq(texts) -- known, do: %{"value" => text}
    %{"name" => attribute_name(type), "kind" => "finite", "values" => choices ++ others}
  end

  defp attribute_json(type, _none, _texts),
    do: %{"name" => attribute_name(type), "kind" => "text"}

  defp read_types(document) do
    for {_, %{"LINGUISTIC_TYPE_ID" => id} = type, _} <-
          Xml.list_children(document, "LINGUISTIC_TYPE"),
        into: %{} do
      relation = @relations[type["CONSTRAINTS"]]

      {id,
       %{
         relation: relation && Atom.to_string(relation),
         vocabulary: type["CONTROLLED_VOCABULARY_REF"]
       }}
    end
  end

  @doc "Returns the values of each controlled vocabulary, in the form of a schema's values."
  @spec read_vocabularies(Xml.element()) :: %{String.t() => [map()]}
  def read_vocabularies(document) do
    for {_, %{"CV_ID" => id}, _} = cv <- Xml.list_children(document, "CONTROLLED_VOCABULARY"),
        into: %{} do
      entries =
        for(entry <- Xml.list_children(cv, "CV_ENTRY_ML"), do: multilingual_entry(entry)) ++
          for {_, attributes, _} = entry <- Xml.list_children(cv, "CV_ENTRY"),
              do: choice_json(Xml.text_content(entry), attributes["DESCRIPTION"])

      {id, entries |> Enum.reject(&(&1 == nil)) |> Enum.uniq_by(& &1["value"])}
    end
  end

  # A value in several languages has the text of its first language.
  defp multilingual_entry(entry) do
    case Xml.list_children(entry, "CVE_VALUE") do
      [{_, attributes, _} = value | _] ->
        choice_json(Xml.text_content(value), attributes["DESCRIPTION"])

      [] ->
        nil
    end
  end

  defp choice_json(text, description) do
    if description in [nil, ""],
      do: %{"value" => text},
      else: %{"value" => text, "description" => description}
  end

  @doc "Describes, in sentences, the parts of a document that are not read."
  @spec describe_losses(Xml.element(), document_rows()) :: [String.t()]
  def describe_losses(document, %{missing: missing, interpolated: interpolated}) do
    languages =
      for cv <- Xml.list_children(document, "CONTROLLED_VOCABULARY"),
          entry <- Xml.list_children(cv, "CV_ENTRY_ML"),
          do: length(Xml.list_children(entry, "CVE_VALUE"))

    external =
      for {_, %{"EXT_REF" => _}, _} <- Xml.list_children(document, "CONTROLLED_VOCABULARY"), do: 1

    for {true, text} <- [
          {missing > 0, "#{missing} annotations have no times and are left out"},
          {interpolated > 0, "#{interpolated} boundaries have no time and were interpolated"},
          {Enum.any?(languages, &(&1 > 1)),
           "vocabularies have several languages; the first one is used"},
          {external != [],
           "#{length(external)} external vocabularies are not read: the values in use are kept as text"}
        ],
        do: text
  end
end
