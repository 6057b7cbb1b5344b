defmodule Situ.Annotation.Tier do
  @moduledoc false
  # Describes a tier of a `Situ.Annotation.Schema`: a track whose annotations have one attribute, and may depend on the
  # annotations of a parent tier. The parent of an annotation follows from its time.
  # See docs/adr/0192-the-parent-of-an-annotation-follows-from-its-time.md.

  @relations %{
    "included_in" => :included_in,
    "time_subdivision" => :time_subdivision,
    "symbolic_subdivision" => :symbolic_subdivision,
    "symbolic_association" => :symbolic_association
  }
  @symbolic [:symbolic_subdivision, :symbolic_association]

  @enforce_keys [:name, :attribute]
  defstruct [:name, :attribute, :parent, :relation, :participant]

  @type relation ::
          :included_in | :time_subdivision | :symbolic_subdivision | :symbolic_association
  @type t :: %__MODULE__{
          name: String.t(),
          attribute: String.t(),
          parent: String.t() | nil,
          relation: relation() | nil,
          participant: String.t() | nil
        }

  @doc "Returns the relations by their names in JSON."
  @spec relations() :: %{String.t() => relation()}
  def relations, do: @relations

  @doc "Returns whether the times of a tier's annotations follow from their parents."
  @spec symbolic?(t()) :: boolean()
  def symbolic?(%__MODULE__{relation: relation}), do: relation in @symbolic

  @doc "Parses the tiers of a schema with these attributes; returns `{:error, why}` for the first invalid one."
  @spec parse_all(term(), [String.t()]) :: {:ok, [t()]} | {:error, String.t()}
  def parse_all(nil, _attributes), do: {:ok, []}

  def parse_all(list, attributes) when is_list(list) do
    list
    |> Enum.reduce_while({:ok, []}, fn json, {:ok, done} ->
      case parse_tier(json, attributes) do
        {:ok, tier} -> {:cont, {:ok, [tier | done]}}
        {:error, why} -> {:halt, {:error, why}}
      end
    end)
    |> case do
      {:ok, tiers} -> tiers |> Enum.reverse() |> check_tiers()
      error -> error
    end
  end

  def parse_all(_, _attributes), do: {:error, "\"tiers\" is not a list"}

  defp parse_tier(%{"name" => name, "attribute" => attribute} = json, attributes)
       when is_binary(name) and is_binary(attribute) do
    %{"parent" => parent, "relation" => relation} =
      Map.merge(%{"parent" => nil, "relation" => nil}, json)

    cond do
      String.trim(name) == "" ->
        {:error, "a tier has an empty name"}

      attribute not in attributes ->
        {:error, "tier #{inspect(name)} has the unknown attribute #{inspect(attribute)}"}

      parent == nil and relation == nil ->
        {:ok, new(json)}

      not is_binary(parent) or not is_map_key(@relations, relation) ->
        names = @relations |> Map.keys() |> Enum.sort() |> Enum.join(", ")
        {:error, "tier #{inspect(name)} needs both a parent and a relation (#{names})"}

      true ->
        {:ok, new(json)}
    end
  end

  defp parse_tier(_, _), do: {:error, "a tier must have a \"name\" and an \"attribute\""}

  defp new(json) do
    %__MODULE__{
      name: json["name"],
      attribute: json["attribute"],
      parent: json["parent"],
      relation: @relations[json["relation"]],
      participant: if(is_binary(json["participant"]), do: json["participant"])
    }
  end

  defp check_tiers(tiers) do
    by_name = Map.new(tiers, &{&1.name, &1})

    if map_size(by_name) < length(tiers),
      do: {:error, "two tiers have the same name"},
      else: Enum.find_value(tiers, {:ok, tiers}, &parent_error(&1, by_name))
  end

  defp parent_error(%{parent: nil}, _by_name), do: nil

  defp parent_error(tier, by_name) do
    parent = by_name[tier.parent]

    cond do
      parent == nil ->
        {:error,
         "the parent #{inspect(tier.parent)} of tier #{inspect(tier.name)} does not exist"}

      cyclic?(tier, by_name, map_size(by_name)) ->
        {:error, "tier #{inspect(tier.name)} is its own ancestor"}

      symbolic?(parent) and not symbolic?(tier) ->
        {:error,
         "tier #{inspect(tier.name)} has times, but its parent #{inspect(tier.parent)} is symbolic"}

      true ->
        nil
    end
  end

  defp cyclic?(%{parent: nil}, _by_name, _left), do: false
  defp cyclic?(_tier, _by_name, 0), do: true

  defp cyclic?(tier, by_name, left) do
    case by_name[tier.parent] do
      nil -> false
      parent -> cyclic?(parent, by_name, left - 1)
    end
  end

  @doc "Converts a tier to its JSON form."
  @spec to_json(t()) :: map()
  def to_json(%__MODULE__{} = tier) do
    for {key, value} <- Map.from_struct(tier), value != nil, into: %{} do
      {Atom.to_string(key), if(is_atom(value), do: Atom.to_string(value), else: value)}
    end
  end

  @doc """
  Returns the tier of a track: the tier of that name, or for a track `TIER@PERSON` the tier `TIER` of that person.
  """
  @spec find_tier([t()], String.t()) :: t() | nil
  def find_tier([], _track), do: nil

  def find_tier(tiers, track) do
    with nil <- Enum.find(tiers, &(&1.name == track)),
         {base, person} <- split_person(track),
         %{} = tier <- Enum.find(tiers, &(&1.name == base)),
         do: put_person(tier, person)
  end

  defp put_person(tier, person) do
    parent = if tier.parent, do: "#{tier.parent}@#{person}"
    %{tier | name: "#{tier.name}@#{person}", parent: parent, participant: person}
  end

  defp split_person(track) do
    case track |> String.split("@") |> Enum.split(-1) do
      {[_ | _] = base, [person]} when person != "" -> {Enum.join(base, "@"), person}
      _ -> nil
    end
  end

  @doc "Returns the tiers that depend on the tier of a track."
  @spec child_tiers([t()], String.t()) :: [t()]
  def child_tiers(tiers, track) do
    if Enum.any?(tiers, &(&1.name == track)),
      do: Enum.filter(tiers, &(&1.parent == track)),
      else: person_children(tiers, split_person(track))
  end

  defp person_children(_tiers, nil), do: []

  defp person_children(tiers, {base, person}),
    do: for(tier <- tiers, tier.parent == base, do: put_person(tier, person))

  @doc "Returns the track of the root tier above a track, or the track itself."
  @spec root_track([t()], String.t()) :: String.t()
  def root_track(tiers, track) do
    case find_tier(tiers, track) do
      %{parent: parent} when parent != nil -> root_track(tiers, parent)
      _ -> track
    end
  end
end
