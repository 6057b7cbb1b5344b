defmodule Situ.Studio.Annotations.TierList do
  @moduledoc false
  # Lists the tiers of a layer for the page: the tiers of its schema, for every person who has a track.
  alias Situ.Annotation.{Layer, Schema}

  @doc """
  Returns the track, attribute, parent, relation and depth of each tier.

      iex> alias Situ.Annotation.{Layer, Schema}
      iex> {:ok, schema} = Schema.parse(%{"name" => "S", "attributes" => [%{"name" => "Text", "kind" => "text"}],
      ...>   "tiers" => [%{"name" => "A", "attribute" => "Text"},
      ...>     %{"name" => "B", "attribute" => "Text", "parent" => "A", "relation" => "included_in"}]})
      iex> {:ok, layer} = Layer.new(schema, [Situ.Annotation.new(0, 9, "A@Ada", %{"Text" => ""})])
      iex> for tier <- Situ.Studio.Annotations.TierList.list_tiers(layer), do: {tier.track, tier.parent, tier.depth}
      [{"A@Ada", nil, 0}, {"B@Ada", "A@Ada", 1}]
  """
  @spec list_tiers(Layer.t()) :: [map()]
  def list_tiers(%Layer{schema: schema} = layer) do
    people = list_people(layer)
    used = Layer.track_names(layer)

    for tier <- schema.tiers,
        name <- tier_tracks(schema, tier, people, used),
        tier = Schema.find_tier(schema, name) do
      %{
        track: name,
        attribute: tier.attribute,
        parent: tier.parent,
        relation: tier.relation,
        depth: Schema.find_depth(schema, name)
      }
    end
  end

  defp list_people(layer) do
    exact = Enum.map(layer.schema.tiers, & &1.name)

    for track <- Layer.track_names(layer),
        track not in exact,
        tier = Schema.find_tier(layer.schema, track),
        uniq: true,
        do: tier.participant
  end

  # The track without a person is listed if it is used, or if no person has tracks.
  defp tier_tracks(schema, tier, people, used) do
    names = Enum.map(schema.tiers, & &1.name)
    own? = people == [] or Enum.any?(names, &(&1 in used))
    if(own?, do: [tier.name], else: []) ++ Enum.map(people, &"#{tier.name}@#{&1}")
  end
end
