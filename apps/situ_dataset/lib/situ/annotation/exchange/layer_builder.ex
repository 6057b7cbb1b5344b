defmodule Situ.Annotation.Exchange.LayerBuilder do
  @moduledoc false
  # Builds a layer from the annotations of a file. No rule of the formats forbids overlaps on a track: the second of two
  # overlapping annotations gets another track. Annotations of child tiers come after their parents. Those without a
  # parent, or without room beside their siblings, get another track, too.
  alias Situ.Annotation
  alias Situ.Annotation.{Layer, Schema, TierRules}

  @doc "Builds a layer from annotations without ids, and describes in sentences what was changed."
  @spec build_layer(Schema.t(), [Annotation.t()]) ::
          {:ok, Layer.t(), [String.t()]} | {:error, Situ.Error.t()}
  def build_layer(schema, annotations) do
    {:ok, empty} = Layer.new(schema)

    {roots, children} = Enum.split_with(annotations, &(Schema.find_depth(schema, &1.track) == 0))

    roots
    |> Enum.sort_by(&{&1.from, &1.to})
    |> add_all({:ok, empty, 0}, 1)
    |> add_children(children, 1)
    |> case do
      {:ok, layer, 0} ->
        {:ok, layer, []}

      {:ok, layer, n} ->
        {:ok, layer,
         [
           "#{n} annotations overlap with others of their track or have no parent: they were moved to additional " <>
             "tracks"
         ]}

      error ->
        error
    end
  end

  # `first` is the number of the first track to try: 1 is the annotation's own track.
  defp add_all(annotations, start, first) do
    Enum.reduce_while(annotations, start, fn annotation, {:ok, layer, moved} ->
      case add_on_free_track(layer, annotation, annotation.track, first) do
        {:ok, layer, 1} -> {:cont, {:ok, layer, moved}}
        {:ok, layer, _} -> {:cont, {:ok, layer, moved + 1}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  defp add_children({:ok, layer, moved}, [_ | _] = children, depth) do
    {these, deeper} =
      Enum.split_with(children, &(Schema.find_depth(layer.schema, &1.track) == depth))

    {layer, refused} = insert_children(layer, these)
    refused |> add_all({:ok, layer, moved}, 2) |> add_children(deeper, depth + 1)
  end

  defp add_children(result, _children, _depth), do: result

  defp add_on_free_track(layer, annotation, track, n) do
    case Layer.add(layer, %{annotation | track: number_track(layer.schema, track, n)}) do
      {:ok, layer, _} ->
        {:ok, layer, n}

      {:error, %{code: code}} when code in [:overlap, :no_parent, :bad_tier] ->
        add_on_free_track(layer, annotation, track, n + 1)

      {:error, error} ->
        {:error, error}
    end
  end

  defp number_track(_schema, track, 1), do: track

  # `Words@Ada (2)` would be the tier `Words` of another person. A schema has finitely many tiers, so a number exists
  # with which the track has none.
  defp number_track(schema, track, n) do
    name = "#{track} (#{n})"

    case Schema.find_tier(schema, name) do
      %{participant: person} when person != nil ->
        String.replace(track, ~r/(?=@[^@]*$)/, " (#{n})")

      _ ->
        name
    end
  end

  # Returns the layer and the annotations that have no parent or overlap others.
  defp insert_children(layer, annotations) do
    families =
      annotations
      |> Enum.group_by(&{&1.track, parent_near(layer, &1)})
      |> Enum.sort_by(fn {{track, parent}, _} -> {track, parent && parent.from} end)

    {with_parent, orphans} = Enum.split_with(families, fn {{_, parent}, _} -> parent != nil end)
    {fitted, refused} = with_parent |> Enum.map(&fit_family(layer.schema, &1)) |> Enum.unzip()
    refused = Enum.concat(Enum.map(orphans, &elem(&1, 1)) ++ refused)

    # Usually all families are valid. If not, each one is tried alone.
    case insert_all(layer, Enum.concat(fitted)) do
      {:ok, layer} ->
        {layer, refused}

      {:error, _} ->
        Enum.reduce(fitted, {layer, refused}, fn family, {layer, refused} ->
          case insert_all(layer, family) do
            {:ok, layer} -> {layer, refused}
            {:error, _} -> {layer, family ++ refused}
          end
        end)
    end
  end

  defp insert_all(layer, annotations) do
    new = for {a, id} <- Enum.with_index(annotations, layer.next), do: {id, nil, %{a | id: id}}

    Layer.apply_transaction(layer, new)
  end

  # Returns the children with the times of their relation, and those that have no room.
  defp fit_family(schema, {{track, parent}, family}) do
    tier = Schema.find_tier(schema, track)

    numbered =
      for {a, i} <- family |> Enum.sort_by(&{&1.from, &1.to}) |> Enum.with_index(),
          do: %{a | id: i}

    fitted = numbered |> TierRules.fit_times(tier.relation, parent) |> drop_overlaps()
    kept = MapSet.new(fitted, & &1.id)

    {for(a <- fitted, do: %{a | id: nil, values: Map.take(a.values, [tier.attribute])}),
     for(a <- numbered, a.id not in kept, do: %{a | id: nil})}
  end

  # The annotations are sorted by start, so each one can only overlap with the last that was kept.
  defp drop_overlaps(annotations) do
    annotations
    |> Enum.reduce([], fn
      a, [last | _] = kept -> if Annotation.overlap?(last, a), do: kept, else: [a | kept]
      a, [] -> [a]
    end)
    |> Enum.reverse()
  end

  defp parent_near(layer, annotation) do
    %{parent: parent} = Schema.find_tier(layer.schema, annotation.track)

    layer
    |> Layer.between(parent, annotation.from, annotation.to)
    |> Enum.filter(&(annotation.from == annotation.to or Annotation.overlap?(&1, annotation)))
    |> Enum.max_by(&{min(&1.to, annotation.to) - max(&1.from, annotation.from), &1.to}, fn ->
      nil
    end)
  end
end
