defmodule Situ.Annotation.Exchange.LayerBuilder do
  @moduledoc false
  # Builds a layer from the annotations of a file. No rule of the formats forbids overlaps on a track: the second of two
  # overlapping annotations gets another track. Annotations of child tiers come after their parents. Those without a
  # parent get another track, too.
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
    |> add_all({:ok, empty, 0})
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

  defp add_all(annotations, start) do
    Enum.reduce_while(annotations, start, fn annotation, {:ok, layer, moved} ->
      case add_on_free_track(layer, annotation, annotation.track, 1) do
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
    refused |> add_all({:ok, layer, moved}) |> add_children(deeper, depth + 1)
  end

  defp add_children(result, _children, _depth), do: result

  defp add_on_free_track(layer, annotation, track, n) do
    name = if n == 1, do: track, else: "#{track} (#{n})"

    case Layer.add(layer, %{annotation | track: name}) do
      {:ok, layer, _} ->
        {:ok, layer, n}

      {:error, %{code: code}} when code in [:overlap, :no_parent, :bad_tier] ->
        add_on_free_track(layer, annotation, track, n + 1)

      {:error, error} ->
        {:error, error}
    end
  end

  # Returns the layer and the annotations that have no parent or overlap others.
  defp insert_children(layer, annotations) do
    families =
      annotations
      |> Enum.group_by(&{&1.track, parent_near(layer, &1)})
      |> Enum.sort_by(fn {{track, parent}, _} -> {track, parent && parent.from} end)

    {with_parent, orphans} = Enum.split_with(families, fn {{_, parent}, _} -> parent != nil end)
    refused = Enum.flat_map(orphans, &elem(&1, 1))

    # Usually all families are valid. If not, each one is tried alone.
    case insert_families(layer, with_parent) do
      {:ok, layer} ->
        {layer, refused}

      :error ->
        Enum.reduce(with_parent, {layer, refused}, fn {_, own} = family, {layer, refused} ->
          case insert_families(layer, [family]) do
            {:ok, layer} -> {layer, refused}
            :error -> {layer, own ++ refused}
          end
        end)
    end
  end

  defp insert_families(layer, families) do
    fitted = Enum.map(families, &fit_family(layer.schema, &1))

    new =
      for {a, id} <- fitted |> Enum.concat() |> Enum.with_index(layer.next),
          do: {id, nil, %{a | id: id}}

    with true <- length(new) == Enum.sum(for {_, own} <- families, do: length(own)),
         {:ok, layer} <- Layer.apply_transaction(layer, new) do
      {:ok, layer}
    else
      _ -> :error
    end
  end

  defp fit_family(schema, {{track, parent}, family}) do
    tier = Schema.find_tier(schema, track)

    for a <-
          family |> Enum.sort_by(&{&1.from, &1.to}) |> TierRules.fit_times(tier.relation, parent),
        do: %{a | values: Map.take(a.values, [tier.attribute])}
  end

  defp parent_near(layer, annotation) do
    %{parent: parent} = Schema.find_tier(layer.schema, annotation.track)

    layer
    |> Layer.between(parent, annotation.from, annotation.to)
    |> Enum.max_by(&{min(&1.to, annotation.to) - max(&1.from, annotation.from), &1.to}, fn ->
      nil
    end)
  end
end
