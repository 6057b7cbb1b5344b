defmodule Situ.Annotation.Exchange.LabelRows do
  @moduledoc false
  # Converts a layer to rows of labelled intervals, one per track and attribute, like the tiers of ELAN and Praat,
  # and converts rows to annotations.
  alias Situ.Annotation
  alias Situ.Annotation.{Layer, Schema}

  @type label :: {from :: integer(), to :: integer(), text :: String.t()}
  @type row :: {name :: String.t(), [label()]}

  @doc "Returns the rows of a layer by track and then in the order of the attributes; times are unchanged."
  @spec layer_rows(Layer.t()) :: [{String.t(), String.t(), [{Annotation.t(), String.t()}]}]
  def layer_rows(layer) do
    attributes = layer.schema.attributes

    for track <- Layer.track_names(layer),
        tier <- [Schema.find_tier(layer.schema, track)],
        attribute <- attributes,
        tier == nil or tier.attribute == attribute.name do
      labels =
        for a <- Layer.on_track(layer, track), do: {a, value_to_text(a.values[attribute.name])}

      {track, if(tier, do: track, else: row_name(track, attribute.name, attributes)), labels}
    end
  end

  defp row_name(track, _attribute, [_]), do: track
  defp row_name(track, attribute, _), do: "#{track}.#{attribute}"

  @doc "Formats a value as text."
  @spec value_to_text(term()) :: String.t()
  def value_to_text(nil), do: ""
  def value_to_text(value) when is_binary(value), do: value
  def value_to_text(value), do: to_string(value)

  @doc """
  Builds annotations from rows, with or without a schema. With a schema that has several attributes, the rows
  `TRACK.ATTRIBUTE` of a track are joined where their intervals are equal.
  """
  @spec rows_to_annotations([row()], Schema.t() | nil) :: {[Annotation.t()], [String.t()]}
  def rows_to_annotations(rows, schema) do
    labelled =
      for {name, labels} <- rows,
          {track, attribute} = find_attribute(name, schema),
          l <- labels,
          do: {track, attribute, l}

    {annotations, refused} =
      labelled
      |> Enum.group_by(fn {track, _, {from, to, _}} -> {from, to, track} end, fn {_, a,
                                                                                  {_, _, text}} ->
        {a, text}
      end)
      |> Enum.map_reduce(0, fn {{from, to, track}, texts}, refused ->
        {values, bad} = parse_values(texts, schema)
        {%Annotation{from: from, to: max(to, from), track: track, values: values}, refused + bad}
      end)

    losses =
      if refused > 0,
        do: ["#{refused} labels do not fit the schema and were replaced by the defaults"],
        else: []

    {Enum.sort_by(annotations, &{&1.from, &1.to, &1.track}), losses}
  end

  defp find_attribute(name, schema) do
    case schema && Schema.find_tier(schema, name) do
      nil -> split_row_name(name, schema)
      tier -> {name, tier.attribute}
    end
  end

  # The row's name ends with the attribute name; a row without one belongs to the track's first attribute.
  defp split_row_name(name, %Schema{attributes: [_, _ | _] = attributes}) do
    attribute =
      Enum.find(attributes, &(String.ends_with?(name, "." <> &1.name) and name != "." <> &1.name))

    if attribute,
      do: {String.replace_suffix(name, "." <> attribute.name, ""), attribute.name},
      else: {name, hd(attributes).name}
  end

  defp split_row_name(name, %Schema{attributes: [attribute]}), do: {name, attribute.name}
  defp split_row_name(name, nil), do: {name, "Value"}

  defp parse_values(texts, nil), do: {Map.new(texts), 0}

  defp parse_values(texts, schema) do
    Enum.reduce(texts, {%{}, 0}, fn {attribute, text}, {values, bad} ->
      case Schema.parse_value(schema, attribute, text) do
        {:ok, value} -> {Map.put(values, attribute, value), bad}
        {:error, _} -> {values, bad + 1}
      end
    end)
  end

  @doc "Describes, in sentences, the data that is lost in a format that does not store the fields in `left_out`."
  @spec describe_losses(
          [Annotation.t()],
          [:by | :confidence | :note | :proposed? | :fine],
          String.t()
        ) ::
          [String.t()]
  def describe_losses(annotations, left_out, format) do
    for field <- left_out,
        n = Enum.count(annotations, &loses_field?(&1, field)),
        n > 0,
        do: describe_loss(field, n, format)
  end

  defp loses_field?(a, :fine), do: rem(a.from, 1_000_000) != 0 or rem(a.to, 1_000_000) != 0
  defp loses_field?(a, :proposed?), do: a.proposed?
  defp loses_field?(a, field), do: Map.fetch!(a, field) != nil

  defp describe_loss(:fine, n, format),
    do: "#{format} stores milliseconds: the times of #{n} annotations are rounded"

  defp describe_loss(:proposed?, n, format),
    do: "#{format} does not store proposals: #{n} proposals become ordinary annotations"

  defp describe_loss(field, n, format),
    do: "#{format} does not store #{field_plural(field)}; they are lost for #{n} annotations"

  defp field_plural(:by), do: "annotators"
  defp field_plural(:confidence), do: "confidences"
  defp field_plural(:note), do: "notes"
end
