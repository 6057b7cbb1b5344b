defmodule Situ.Annotation.Exchange.Elan.TierWriter do
  @moduledoc false
  # Writes the tiers of a layer in ELAN's format: a tier for each track, or for each track and attribute. Annotations of
  # symbolic tiers refer to their parents. The others refer to time slots. Only annotations that touch in ELAN, too (a
  # subdivision and its parent), share a slot, because ELAN moves all annotations at a slot together.
  alias Situ.Annotation.Exchange.LabelRows
  alias Situ.Annotation.{Layer, Schema, Tier, TierRules}
  alias Situ.Xml

  @ms 1_000_000
  @words %{
    included_in: "Included_In",
    time_subdivision: "Time_Subdivision",
    symbolic_subdivision: "Symbolic_Subdivision",
    symbolic_association: "Symbolic_Association"
  }

  @doc "Returns the names of the relations in ELAN's files."
  @spec relation_words() :: %{Tier.relation() => String.t()}
  def relation_words, do: @words

  @doc "Returns the elements of the time slots and of the tiers."
  @spec encode_tiers(Layer.t(), integer()) :: {iodata(), iodata()}
  def encode_tiers(layer, origin) do
    rows = layer |> list_rows() |> number_annotations()
    ids = for {_, labels} <- rows, {n, a, _} <- labels, into: %{}, do: {{a.id, a.track}, n}
    context = %{layer: layer, origin: origin, ids: ids}

    # Every slot is a place (a row, an annotation and an end) with a time.
    slots =
      for {row, labels} <- rows,
          not symbolic_row?(row),
          {_, a, _} <- labels,
          edge <- [:from, :to],
          into: %{},
          do: {slot_place(context, row, a, edge), ns_to_ms(Map.fetch!(a, edge) - origin)}

    numbers =
      slots
      |> Enum.sort_by(fn {place, ms} -> {ms, place} end)
      |> Enum.with_index(1)
      |> Map.new(fn {{place, _}, n} -> {place, n} end)

    times =
      for {place, n} <- Enum.sort_by(numbers, &elem(&1, 1)),
          do: ~s(        <TIME_SLOT TIME_SLOT_ID="ts#{n}" TIME_VALUE="#{slots[place]}"/>\n)

    {times, Enum.map(rows, &encode_tier(&1, Map.put(context, :numbers, numbers)))}
  end

  # All times are rounded in the same way, so that annotations that touch keep touching.
  defp ns_to_ms(ns), do: Integer.floor_div(ns + div(@ms, 2), @ms)

  # Parents come before their children; tiers without annotations are included.
  defp list_rows(layer) do
    rows =
      for {track, name, labels} <- LabelRows.layer_rows(layer),
          do: {%{name: name, track: track, tier: Schema.find_tier(layer.schema, track)}, labels}

    names = for {row, _} <- rows, do: row.track
    exact = Enum.map(layer.schema.tiers, & &1.name)

    people =
      for {%{track: track, tier: %{participant: p}}, _} <- rows,
          track not in exact,
          uniq: true,
          do: p

    empty =
      for tier <- layer.schema.tiers,
          name <- [tier.name | Enum.map(people, &"#{tier.name}@#{&1}")],
          name not in names,
          tier = Schema.find_tier(layer.schema, name),
          name == tier.name,
          tier_needed?(layer.schema, names, tier),
          do: {%{name: name, track: name, tier: tier}, []}

    Enum.sort_by(rows ++ empty, fn {row, _} -> {tier_depth(layer.schema, row.tier), row.name} end)
  end

  # A tier for all people has no separate track if only the tracks of people are used.
  defp tier_needed?(schema, names, tier) do
    used? = Enum.any?(names, &(Schema.find_tier(schema, &1) != nil))
    family = family_names(schema, Tier.root_track(schema.tiers, tier.name))
    not used? or Enum.any?(family, &(&1 in names)) or not shared_by_people?(names, tier)
  end

  defp shared_by_people?(names, tier),
    do: Enum.any?(names, &String.starts_with?(&1, tier.name <> "@"))

  defp family_names(schema, track) do
    children = for tier <- Schema.child_tiers(schema, track), do: family_names(schema, tier.name)
    [track | Enum.concat(children)]
  end

  defp tier_depth(_schema, nil), do: 0
  defp tier_depth(_schema, %{parent: nil}), do: 0
  defp tier_depth(schema, tier), do: 1 + tier_depth(schema, Schema.find_tier(schema, tier.parent))

  defp number_annotations(rows) do
    {rows, _} =
      Enum.map_reduce(rows, 1, fn {row, labels}, n ->
        {labels, n} = Enum.map_reduce(labels, n, fn {a, text}, n -> {{n, a, text}, n + 1} end)
        {{row, labels}, n}
      end)

    rows
  end

  defp symbolic_row?(%{tier: nil}), do: false
  defp symbolic_row?(%{tier: tier}), do: Tier.symbolic?(tier)

  # The first and last part of a subdivision share the slots of their parent, and each part shares one with the next.
  defp slot_place(context, %{tier: %{relation: :time_subdivision, parent: parent}}, a, edge) do
    owner = TierRules.parent_annotation(context.layer, a)
    time = Map.fetch!(a, edge)

    cond do
      owner && time == owner.from -> parent_place(context, parent, owner, :from)
      owner && time == owner.to -> parent_place(context, parent, owner, :to)
      true -> {a.track, :between, time}
    end
  end

  defp slot_place(_context, row, a, edge), do: {row.name, a.id, edge}

  defp parent_place(context, parent, owner, edge) do
    tier = Schema.find_tier(context.layer.schema, parent)
    slot_place(context, %{name: parent, tier: tier}, owner, edge)
  end

  defp encode_tier({row, labels}, context) do
    tier = row.tier
    parent = tier && tier.parent
    participant = tier && tier.participant

    [
      ~s(    <TIER LINGUISTIC_TYPE_REF="#{Xml.escape(type_name(context.layer.schema, row))}"),
      encode_attribute("PARENT_REF", parent),
      encode_attribute("PARTICIPANT", participant),
      encode_attribute("ANNOTATOR", single_annotator(labels)),
      ~s( TIER_ID="#{Xml.escape(row.name)}">\n),
      labels
      |> Enum.zip([nil | labels])
      |> Enum.map(&encode_annotation(&1, row, context)),
      "    </TIER>\n"
    ]
  end

  defp encode_attribute(_name, nil), do: ""
  defp encode_attribute(name, value), do: ~s( #{name}="#{Xml.escape(value)}")

  # ELAN stores one annotator per tier.
  defp single_annotator(labels) do
    case labels |> Enum.map(fn {_, a, _} -> a.by end) |> Enum.uniq() do
      [by] when is_binary(by) -> by
      _ -> nil
    end
  end

  defp encode_annotation({{n, a, text}, before}, row, context) do
    [
      "        <ANNOTATION>\n",
      if(symbolic_row?(row),
        do: encode_reference({n, a}, before, row, context),
        else: encode_times({n, a}, row, context)
      ),
      ~s(                <ANNOTATION_VALUE>#{Xml.escape(text)}</ANNOTATION_VALUE>\n),
      if(symbolic_row?(row),
        do: "            </REF_ANNOTATION>\n",
        else: "            </ALIGNABLE_ANNOTATION>\n"
      ),
      "        </ANNOTATION>\n"
    ]
  end

  defp encode_times({n, a}, row, %{numbers: numbers} = context) do
    [from, to] = for edge <- [:from, :to], do: numbers[slot_place(context, row, a, edge)]

    ~s(            <ALIGNABLE_ANNOTATION ANNOTATION_ID="a#{n}" ) <>
      ~s(TIME_SLOT_REF1="ts#{from}" TIME_SLOT_REF2="ts#{to}">\n)
  end

  defp encode_reference({n, a}, before, row, context) do
    parent = TierRules.parent_annotation(context.layer, a)
    reference = context.ids[{parent.id, parent.track}]

    previous =
      with %{relation: :symbolic_subdivision} <- row.tier,
           {m, earlier, _} when earlier.to > parent.from <- before do
        ~s( PREVIOUS_ANNOTATION="a#{m}")
      else
        _ -> ""
      end

    ~s(            <REF_ANNOTATION ANNOTATION_ID="a#{n}" ANNOTATION_REF="a#{reference}"#{previous}>\n)
  end

  @doc """
  Returns the name of a row's linguistic type: the attribute, with the relation if the attribute's tiers have several.
  """
  @spec type_name(Schema.t(), map()) :: String.t()
  def type_name(schema, %{tier: nil} = row) do
    [first | _] = schema.attributes
    Enum.find(schema.attributes, first, &(row.name == "#{row.track}.#{&1.name}")).name
  end

  def type_name(schema, %{tier: tier}), do: type_name(schema, tier.attribute, tier.relation)

  @spec type_name(Schema.t(), String.t(), Tier.relation() | nil) :: String.t()
  def type_name(schema, attribute, relation) do
    relations =
      for tier <- schema.tiers, tier.attribute == attribute, uniq: true, do: tier.relation

    if relation == nil or length(relations) == 1,
      do: attribute,
      else: "#{attribute} (#{@words[relation]})"
  end
end
