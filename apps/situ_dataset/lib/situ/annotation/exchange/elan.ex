defmodule Situ.Annotation.Exchange.Elan do
  @moduledoc false
  # Reads and writes ELAN's annotation files (`.eaf`, format 3.0), with a tier for each track, or
  # for each track and attribute.
  #
  # Times are milliseconds from `origin:`. The header stores the schema and the origin as
  # properties (`situ.schema`, `situ.origin`). Finite attributes are also written as controlled
  # vocabularies, so that ELAN offers their values. Annotations that refer to others
  # (`REF_ANNOTATION`) get the times of the annotation that they refer to.
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation.Exchange.LabelRows
  alias Situ.Xml
  alias Situ.Annotation.{Layer, Schema}

  @ms 1_000_000

  @impl true
  def encode(layer, opts) do
    rows = LabelRows.layer_rows(layer)
    slots = slot_times(rows, opts[:origin])
    ids = slots |> Map.keys() |> Enum.sort() |> Enum.with_index(1) |> Map.new()

    text = [
      ~s(<?xml version="1.0" encoding="UTF-8"?>\n),
      ~s(<ANNOTATION_DOCUMENT AUTHOR="" DATE="1970-01-01T00:00:00+00:00" FORMAT="3.0" VERSION="3.0" ),
      ~s(xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" ),
      ~s(xsi:noNamespaceSchemaLocation="http://www.mpi.nl/tools/elan/EAFv3.0.xsd">\n),
      encode_header(layer.schema, opts),
      ["    <TIME_ORDER>\n", encode_time_slots(ids), "    </TIME_ORDER>\n"],
      rows
      |> Enum.zip(annotation_offsets(rows))
      |> Enum.map(&encode_tier(&1, layer.schema, ids, opts[:origin])),
      encode_types(layer.schema),
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

  defp slot_times(rows, origin) do
    for {_, _, labels} <- rows,
        {a, _} <- labels,
        time <- [a.from, a.to],
        into: %{},
        do: {ns_to_ms(time - origin), true}
  end

  # All times are rounded in the same way, so that annotations that touch keep touching.
  defp ns_to_ms(ns), do: Integer.floor_div(ns + div(@ms, 2), @ms)

  defp encode_time_slots(ids) do
    for {ms, id} <- Enum.sort(ids),
        do: ~s(        <TIME_SLOT TIME_SLOT_ID="ts#{id}" TIME_VALUE="#{ms}"/>\n)
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

  defp annotation_offsets(rows) do
    rows
    |> Enum.map(fn {_, _, labels} -> length(labels) end)
    |> Enum.scan(&+/2)
    |> then(&[0 | &1])
  end

  defp encode_tier({{track, name, labels}, offset}, schema, ids, origin) do
    attribute =
      Enum.find(schema.attributes, hd(schema.attributes), &(name == "#{track}.#{&1.name}"))

    [
      ~s(    <TIER LINGUISTIC_TYPE_REF="#{Xml.escape(attribute.name)}" TIER_ID="#{Xml.escape(name)}"),
      encode_annotator(labels) <> ">\n",
      labels
      |> Enum.with_index(offset + 1)
      |> Enum.map(&encode_annotation(&1, ids, origin)),
      "    </TIER>\n"
    ]
  end

  # ELAN stores one annotator per tier.
  defp encode_annotator(labels) do
    case labels |> Enum.map(fn {a, _} -> a.by end) |> Enum.uniq() do
      [by] when is_binary(by) -> ~s( ANNOTATOR="#{Xml.escape(by)}")
      _ -> ""
    end
  end

  defp encode_annotation({{a, text}, n}, ids, origin) do
    [from, to] = for time <- [a.from, a.to], do: Map.fetch!(ids, ns_to_ms(time - origin))

    """
            <ANNOTATION>
                <ALIGNABLE_ANNOTATION ANNOTATION_ID="a#{n}" TIME_SLOT_REF1="ts#{from}" TIME_SLOT_REF2="ts#{to}">
                    <ANNOTATION_VALUE>#{Xml.escape(text)}</ANNOTATION_VALUE>
                </ALIGNABLE_ANNOTATION>
            </ANNOTATION>
    """
  end

  defp encode_types(schema) do
    for attribute <- schema.attributes do
      name = Xml.escape(attribute.name)

      vocabulary =
        if attribute.kind == :finite, do: ~s( CONTROLLED_VOCABULARY_REF="#{name}"), else: ""

      ~s(    <LINGUISTIC_TYPE#{vocabulary} GRAPHIC_REFERENCES="false" LINGUISTIC_TYPE_ID="#{name}"
      TIME_ALIGNABLE="true"/>\n)
    end
  end

  defp encode_vocabularies(schema) do
    if Enum.any?(schema.attributes, &(&1.kind == :finite)) do
      [
        ~s(    <LANGUAGE LANG_DEF="http://cdb.iso.org/lg/CDB-00130975-001" LANG_ID="und" LANG_LABEL="undetermined"/>\n),
        for %{kind: :finite} = attribute <- schema.attributes do
          name = Xml.escape(attribute.name)

          [
            ~s(    <CONTROLLED_VOCABULARY CV_ID="#{name}">\n        <DESCRIPTION LANG_REF="und"/>\n),
            for {choice, n} <- Enum.with_index(attribute.values, 1) do
              value = ~s(<CVE_VALUE LANG_REF="und">#{Xml.escape(choice.value)}</CVE_VALUE>)
              ~s(        <CV_ENTRY_ML CVE_ID="#{name}_#{n}">#{value}</CV_ENTRY_ML>\n)
            end,
            "    </CONTROLLED_VOCABULARY>\n"
          ]
        end
      ]
    else
      []
    end
  end

  @impl true
  def decode(text, opts) do
    with {:ok, {"ANNOTATION_DOCUMENT", _, _} = document} <- Xml.parse(text) do
      properties = header_properties(document)
      schema = opts[:schema] || parse_schema(properties["situ.schema"])
      origin = opts[:origin] || parse_integer(properties["situ.origin"]) || 0
      slots = parse_time_slots(document)
      {rows, missing} = document |> Xml.list_children("TIER") |> parse_rows(slots, origin)
      {annotations, losses} = LabelRows.rows_to_annotations(rows, schema)
      annotations = put_annotators(annotations, document, schema)
      {:ok, schema, annotations, losses ++ describe_untimed(missing)}
    else
      {:ok, {name, _, _}} -> {:error, "its root is #{inspect(name)}, not ANNOTATION_DOCUMENT"}
      {:error, why} -> {:error, why}
    end
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

  defp parse_time_slots(document) do
    for order <- Xml.list_children(document, "TIME_ORDER"),
        {_, %{"TIME_SLOT_ID" => id, "TIME_VALUE" => value}, _} <-
          Xml.list_children(order, "TIME_SLOT"),
        ms = parse_integer(value),
        into: %{},
        do: {id, ms * @ms}
  end

  # An annotation that refers to another one has its times; the other one may itself refer to a third.
  defp parse_rows(tiers, slots, origin) do
    found = for {_, %{"TIER_ID" => name}, _} = tier <- tiers, do: {name, parse_annotations(tier)}

    parents =
      for {_, all} <- found, {id, parent, _, _} <- all, parent, into: %{}, do: {id, parent}

    aligned = for {_, all} <- found, {id, nil, refs, _} <- all, into: %{}, do: {id, refs}

    Enum.map_reduce(found, 0, fn {name, all}, missing ->
      labels =
        for {id, _, _, text} <- all,
            {from, to} <- [aligned[root_annotation(id, parents, 0)]],
            is_map_key(slots, from) and is_map_key(slots, to),
            do: {slots[from] + origin, slots[to] + origin, text}

      {{name, labels}, missing + length(all) - length(labels)}
    end)
  end

  # The limit stops the search in a cycle of references.
  defp root_annotation(id, parents, depth) do
    case parents do
      %{^id => parent} when depth < 100 -> root_annotation(parent, parents, depth + 1)
      _ -> id
    end
  end

  defp parse_annotations(tier) do
    for annotation <- Xml.list_children(tier, "ANNOTATION"),
        {_, _, inner} = annotation,
        {kind, attributes, _} = a <- inner do
      text = a |> Xml.list_children("ANNOTATION_VALUE") |> Enum.map_join(&Xml.text_content/1)

      if kind == "REF_ANNOTATION",
        do: {attributes["ANNOTATION_ID"], attributes["ANNOTATION_REF"], nil, text},
        else:
          {attributes["ANNOTATION_ID"], nil,
           {attributes["TIME_SLOT_REF1"], attributes["TIME_SLOT_REF2"]}, text}
    end
  end

  defp describe_untimed(0), do: []
  defp describe_untimed(n), do: ["#{n} annotations have no times and are left out"]

  defp put_annotators(annotations, document, schema) do
    by =
      for {_, %{"TIER_ID" => name, "ANNOTATOR" => by}, _} <- Xml.list_children(document, "TIER"),
          by != "",
          into: %{},
          do: {name, by}

    for a <- annotations do
      names = [
        a.track
        | for(
            attribute <- (schema && schema.attributes) || [],
            do: "#{a.track}.#{attribute.name}"
          )
      ]

      %{a | by: Enum.find_value(names, &by[&1])}
    end
  end
end
