defmodule Situ.Annotation.OutsideVersion do
  @moduledoc false
  # Turns a version that a program wrote without the log into an operation. Annotations are matched by their content
  # first, because the program may have numbered them differently.
  alias Situ.Annotation.{Layer, LayerOperation, Review, Schema}

  @doc """
  Returns the operation on `current` that makes the changes from the version `before` to the version `later`.
  """
  @spec diff_versions(Layer.t(), Layer.t(), Layer.t()) :: map()
  def diff_versions(%Layer{} = before, %Layer{} = later, %Layer{} = current) do
    {removed, added} = drop_equal(Layer.annotations(before), Layer.annotations(later))
    {changed, removed, added} = match_ids(removed, added)

    numbered =
      for {annotation, id} <- Enum.with_index(added, current.next),
          do: {id, nil, %{annotation | id: id}}

    transaction = for(a <- removed, do: {a.id, a, nil}) ++ changed ++ numbered

    transaction
    |> LayerOperation.encode_transaction()
    |> put_schema(before.schema, later.schema)
    |> put_review(before.review, later.review)
  end

  defp put_schema(operation, same, same), do: operation

  defp put_schema(operation, before, later),
    do: Map.put(operation, "schema", [Schema.to_json(before), Schema.to_json(later)])

  defp put_review(operation, same, same), do: operation

  defp put_review(operation, _before, later),
    do: Map.put(operation, "review", Review.to_json(later))

  defp drop_equal(before, later) do
    contents = Enum.frequencies_by(later, &content/1)

    {removed, left} =
      Enum.reduce(before, {[], contents}, fn annotation, {removed, left} ->
        key = content(annotation)

        case left do
          %{^key => n} when n > 0 -> {removed, %{left | key => n - 1}}
          _ -> {[annotation | removed], left}
        end
      end)

    {added, _} =
      Enum.reduce(later, {[], left}, fn annotation, {added, left} ->
        key = content(annotation)

        if left[key] > 0,
          do: {[annotation | added], %{left | key => left[key] - 1}},
          else: {added, left}
      end)

    {Enum.reverse(removed), Enum.reverse(added)}
  end

  defp content(annotation), do: %{annotation | id: nil}

  # An annotation with the same id on the same track was changed.
  defp match_ids(removed, added) do
    by_id = Map.new(added, &{{&1.id, &1.track}, &1})

    {changed, removed} = Enum.split_with(removed, &is_map_key(by_id, {&1.id, &1.track}))
    pairs = for a <- changed, do: {a.id, a, Map.fetch!(by_id, {a.id, a.track})}
    {pairs, removed, added -- Enum.map(pairs, &elem(&1, 2))}
  end
end
