defmodule Situ.Annotation.Exchange.Elan do
  @moduledoc false
  # Reads and writes ELAN's annotation files (`.eaf`, format 3.0): tiers with their parents, linguistic types and
  # controlled vocabularies. A track without a tier in the schema is a tier, or one for each attribute.
  #
  # Times are milliseconds from `origin:`. The header stores the schema and the origin as properties (`situ.schema`,
  # `situ.origin`). If the file was changed in ELAN, the schema is extended by its new tiers and values.
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation.Exchange.Elan.{TierReader, TierWriter}
  alias Situ.Annotation.Exchange.LabelRows
  alias Situ.Annotation.{Attribute, Layer, Schema, Tier}
  alias Situ.Xml

  @descriptions %{
    included_in:
      "Time alignable annotations within the parent annotation's time interval, gaps are allowed",
    time_subdivision:
      "Time subdivision of parent annotation's time interval, no time gaps allowed within this interval",
    symbolic_subdivision:
      "Symbolic subdivision of a parent annotation. Annotations refering to the same parent are ordered",
    symbolic_association: "1-1 association with a parent annotation"
  }

  @impl true
  def encode(layer, opts) do
    {slots, tiers} = TierWriter.encode_tiers(layer, opts[:origin])

    text = [
      ~s(<?xml version="1.0" encoding="UTF-8"?>\n),
      ~s(<ANNOTATION_DOCUMENT AUTHOR="" DATE="1970-01-01T00:00:00+00:00" FORMAT="3.0" VERSION="3.0" ),
      ~s(xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" ),
      ~s(xsi:noNamespaceSchemaLocation="http://www.mpi.nl/tools/elan/EAFv3.0.xsd">\n),
      encode_header(layer.schema, opts),
      ["    <TIME_ORDER>\n", slots, "    </TIME_ORDER>\n"],
      tiers,
      encode_types(layer.schema),
      encode_language(layer.schema),
      encode_constraints(layer.schema),
      encode_vocabularies(layer.schema),
      "</ANNOTATION_DOCUMENT>\n"
    ]

    {text,
     LabelRows.describe_losses(
       Layer.annotations(layer),
       [:fine, :confidence, :note, :proposed?],
       "ELAN"
     )}
  end

  defp encode_header(schema, opts) do
    media =
      if opts[:media] do
        url = Xml.escape("file://" <> Path.expand(opts[:media]))

        ~s(        <MEDIA_DESCRIPTOR MEDIA_URL="#{url}" MIME_TYPE="#{mime_type(opts[:media])}"/>\n)
      else
        ""
      end

    [
      ~s(    <HEADER MEDIA_FILE="" TIME_UNITS="milliseconds">\n),
      media,
      ~s(        <PROPERTY NAME="situ.schema">#{Xml.escape(Situ.JSON.encode(Schema.to_json(schema)))}</PROPERTY>\n),
      ~s(        <PROPERTY NAME="situ.origin">#{opts[:origin]}</PROPERTY>\n),
      "    </HEADER>\n"
    ]
  end

  defp mime_type(path),
    do: if(Path.extname(path) in [".wav", ".WAV"], do: "audio/x-wav", else: "video/mp4")

  # An attribute has a type for each relation of its tiers to their parents.
  defp encode_types(schema) do
    relations = for tier <- schema.tiers, uniq: true, do: {tier.attribute, tier.relation}

    types =
      for attribute <- schema.attributes do
        own = for {name, relation} <- relations, name == attribute.name, do: relation
        for relation <- Enum.uniq([nil | own]), do: {attribute, relation}
      end

    types
    |> Enum.concat()
    |> Enum.reject(fn {attribute, relation} ->
      relation == nil and dependent?(schema, attribute)
    end)
    |> Enum.map(&encode_type(&1, schema))
  end

  # Tiers of this attribute always have a parent, and its name is the name of their type.
  defp dependent?(schema, attribute) do
    case for tier <- schema.tiers, tier.attribute == attribute.name, uniq: true, do: tier.relation do
      [relation] -> relation != nil
      _ -> false
    end
  end

  defp encode_type({attribute, relation}, schema) do
    name = Xml.escape(TierWriter.type_name(schema, attribute.name, relation))
    aligned? = relation not in [:symbolic_subdivision, :symbolic_association]

    constraint =
      if relation, do: ~s( CONSTRAINTS="#{TierWriter.relation_words()[relation]}"), else: ""

    vocabulary =
      if attribute.kind == :finite,
        do: ~s( CONTROLLED_VOCABULARY_REF="#{Xml.escape(attribute.name)}"),
        else: ""

    ~s(    <LINGUISTIC_TYPE#{constraint}#{vocabulary} GRAPHIC_REFERENCES="false" ) <>
      ~s(LINGUISTIC_TYPE_ID="#{name}" TIME_ALIGNABLE="#{aligned?}"/>\n)
  end

  defp encode_constraints(%{tiers: []}), do: []

  defp encode_constraints(_schema) do
    for {relation, word} <- Enum.sort(TierWriter.relation_words()),
        do:
          ~s(    <CONSTRAINT DESCRIPTION="#{Xml.escape(@descriptions[relation])}" STEREOTYPE="#{word}"/>\n)
  end

  defp encode_language(schema) do
    if Enum.any?(schema.attributes, &(&1.kind == :finite)),
      do:
        ~s(    <LANGUAGE LANG_DEF="http://cdb.iso.org/lg/CDB-00130975-001" LANG_ID="und" LANG_LABEL="undetermined"/>\n),
      else: []
  end

  defp encode_vocabularies(schema) do
    for {%{kind: :finite} = attribute, i} <- Enum.with_index(schema.attributes, 1) do
      [
        ~s(    <CONTROLLED_VOCABULARY CV_ID="#{Xml.escape(attribute.name)}">\n),
        ~s(        <DESCRIPTION LANG_REF="und">#{Xml.escape(attribute.description)}</DESCRIPTION>\n),
        for({choice, n} <- Enum.with_index(attribute.values, 1), do: encode_entry(choice, i, n)),
        "    </CONTROLLED_VOCABULARY>\n"
      ]
    end
  end

  defp encode_entry(choice, i, n) do
    description =
      if choice[:description], do: ~s( DESCRIPTION="#{Xml.escape(choice.description)}"), else: ""

    value = ~s(<CVE_VALUE#{description} LANG_REF="und">#{Xml.escape(choice.value)}</CVE_VALUE>)

    ~s(        <CV_ENTRY_ML CVE_ID="cveid_#{i}_#{n}">#{value}</CV_ENTRY_ML>\n)
  end

  @impl true
  def decode(text, opts) do
    with {:ok, {"ANNOTATION_DOCUMENT", _, _} = document} <- Xml.parse(text) do
      properties = header_properties(document)
      schema = opts[:schema] || find_schema(document, properties, opts)
      origin = opts[:origin] || parse_integer(properties["situ.origin"]) || 0
      read = TierReader.read_rows(document)

      rows =
        for {name, labels} <- read.rows,
            do: {name, for({from, to, text} <- labels, do: {from + origin, to + origin, text})}

      {annotations, losses} = LabelRows.rows_to_annotations(rows, schema)
      annotations = put_annotators(annotations, document, schema)
      {:ok, schema, annotations, losses ++ TierReader.describe_losses(document, read)}
    else
      {:ok, {name, _, _}} -> {:error, "its root is #{inspect(name)}, not ANNOTATION_DOCUMENT"}
      {:error, why} -> {:error, why}
    end
  end

  defp find_schema(document, properties, opts) do
    found = TierReader.read_schema(document, opts[:name] || "Annotation")

    case parse_schema(properties["situ.schema"]) do
      nil -> found
      schema -> extend_schema(schema, found, TierReader.read_vocabularies(document))
    end
  end

  # Adds the values and dependent tiers that were created in ELAN.
  defp extend_schema(schema, found, vocabularies) do
    attributes =
      for attribute <- schema.attributes do
        json = Attribute.to_json(attribute)
        known = Enum.map(attribute.values, & &1.value)
        new = for v <- vocabularies[attribute.name] || [], v["value"] not in known, do: v
        if new == [], do: json, else: Map.update!(json, "values", &(&1 ++ new))
      end

    tiers = new_tiers(schema, found)
    names = Enum.map(schema.attributes, & &1.name)
    needed = for tier <- tiers, tier.attribute not in names, do: tier.attribute
    more = for a <- (found && found.attributes) || [], a.name in needed, do: Attribute.to_json(a)

    json = Schema.to_json(schema)
    all_tiers = (json["tiers"] || []) ++ Enum.map(tiers, &Tier.to_json/1)
    json = Map.merge(json, %{"attributes" => attributes ++ more, "tiers" => all_tiers})

    case Schema.parse(json) do
      {:ok, extended} -> extended
      {:error, _} -> schema
    end
  end

  defp new_tiers(_schema, nil), do: []

  defp new_tiers(schema, found) do
    unknown = for tier <- found.tiers, Schema.find_tier(schema, tier.name) == nil, do: tier
    parents = for tier <- unknown, tier.parent, do: tier.parent
    for tier <- unknown, tier.parent != nil or tier.name in parents, do: tier
  end

  defp header_properties(document) do
    for header <- Xml.list_children(document, "HEADER"),
        {_, %{"NAME" => name}, _} = property <- Xml.list_children(header, "PROPERTY"),
        into: %{},
        do: {name, Xml.text_content(property)}
  end

  defp parse_schema(nil), do: nil

  defp parse_schema(text) do
    with {:ok, json} <- Situ.JSON.decode(text), {:ok, schema} <- Schema.parse(json) do
      schema
    else
      _ -> nil
    end
  end

  defp parse_integer(nil), do: nil

  defp parse_integer(text) do
    case Integer.parse(String.trim(text)) do
      {n, ""} -> n
      _ -> nil
    end
  end

  defp put_annotators(annotations, document, schema) do
    by = TierReader.read_annotators(document)
    attributes = (schema && schema.attributes) || []

    for a <- annotations do
      names = [a.track | Enum.map(attributes, &"#{a.track}.#{&1.name}")]
      %{a | by: Enum.find_value(names, &by[&1])}
    end
  end
end
