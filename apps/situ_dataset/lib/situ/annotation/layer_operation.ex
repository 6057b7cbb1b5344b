defmodule Situ.Annotation.LayerOperation do
  @moduledoc false
  # The operations in the log of a layer as JSON. `annotations` is a transaction: a list of `[id, before, after]`.
  # `schema` is `[before, after]`. `review` replaces the outcomes of a review, which otherwise follow from transactions.
  alias Situ.Annotation
  alias Situ.Annotation.{Layer, Review, Schema}
  alias Situ.EditLog.Entry

  @doc "Encodes a transaction."
  @spec encode_transaction(Layer.transaction()) :: map()
  def encode_transaction(transaction) do
    changes =
      for {id, before, later} <- transaction,
          do: [id, annotation_json(before), annotation_json(later)]

    %{"annotations" => changes}
  end

  defp annotation_json(nil), do: nil
  defp annotation_json(annotation), do: Annotation.to_json(annotation)

  @doc "Reads the transaction of an operation."
  @spec parse_transaction(map()) :: {:ok, Layer.transaction()} | :error
  def parse_transaction(%{"annotations" => changes}) when is_list(changes) do
    parsed = Enum.map(changes, &parse_change/1)
    if :error in parsed, do: :error, else: {:ok, parsed}
  end

  def parse_transaction(%{}), do: {:ok, []}

  defp parse_change([id, before, later]) when is_integer(id) do
    with {:ok, before} <- parse_annotation(before),
         {:ok, later} <- parse_annotation(later),
         do: {id, before, later}
  end

  defp parse_change(_), do: :error

  defp parse_annotation(nil), do: {:ok, nil}

  defp parse_annotation(json) do
    with {:error, _} <- Annotation.from_json(json), do: :error
  end

  @doc """
  Returns the operation that turns one layer into another. Annotations are compared by their ids.
  """
  @spec diff_layers(Layer.t(), Layer.t()) :: map()
  def diff_layers(%Layer{} = before, %Layer{} = later) do
    removed = for {id, a} <- before.by_id, not is_map_key(later.by_id, id), do: {id, a, nil}

    changed = for {id, b} <- later.by_id, before.by_id[id] != b, do: {id, before.by_id[id], b}

    operation = encode_transaction(Enum.sort(removed) ++ Enum.sort(changed))

    operation =
      if before.schema == later.schema,
        do: operation,
        else:
          Map.put(operation, "schema", [
            Schema.to_json(before.schema),
            Schema.to_json(later.schema)
          ])

    if before.review == later.review,
      do: operation,
      else: Map.put(operation, "review", Review.to_json(later.review))
  end

  @doc "Returns whether an operation changes nothing."
  @spec empty?(map()) :: boolean()
  def empty?(operation), do: operation == %{"annotations" => []}

  @doc "Returns the operation that undoes an operation."
  @spec invert(map()) :: map()
  def invert(operation) do
    changes = for [id, a, b] <- Enum.reverse(operation["annotations"] || []), do: [id, b, a]
    inverse = %{"annotations" => changes}

    case operation["schema"] do
      [before, later] -> Map.put(inverse, "schema", [later, before])
      _ -> inverse
    end
  end

  @doc "Applies an entry of a log to a layer. Errors: the errors of `Situ.Annotation.Layer.apply_transaction/2`."
  @spec apply_entry(Layer.t(), Entry.t()) :: {:ok, Layer.t()} | {:error, Situ.Error.t()} | :error
  def apply_entry(%Layer{} = layer, %Entry{kind: kind, do: operation}) do
    with {:ok, transaction} <- parse_transaction(operation),
         {:ok, layer} <- apply_operation(layer, operation, transaction),
         do: {:ok, layer |> forget_undone(kind, transaction) |> put_review(operation["review"])}
  end

  defp apply_operation(layer, %{"schema" => [_before, later]}, transaction) do
    with {:ok, schema} <- Schema.parse(later),
         :ok <- check_current(layer, transaction) do
      by_id =
        Enum.reduce(transaction, layer.by_id, fn
          {id, _, nil}, by_id -> Map.delete(by_id, id)
          {id, _, annotation}, by_id -> Map.put(by_id, id, annotation)
        end)

      with {:ok, new} <- Layer.new(schema, Map.values(by_id), layer.review),
           do: {:ok, %{new | next: max(new.next, layer.next)}}
    end
  end

  defp apply_operation(layer, _operation, transaction),
    do: Layer.apply_transaction(layer, transaction)

  defp check_current(layer, transaction) do
    if Enum.all?(transaction, fn {id, before, _} -> layer.by_id[id] == before end),
      do: :ok,
      else: {:error, Situ.Error.new(:stale_edit, "the annotations were changed by someone else")}
  end

  # Proposals whose addition was undone were not rejected.
  defp forget_undone(layer, "undo", transaction),
    do: %{
      layer
      | review: Review.forget_added(layer.review, Layer.invert_transaction(transaction))
    }

  defp forget_undone(layer, _kind, _transaction), do: layer

  defp put_review(layer, nil), do: layer
  defp put_review(layer, review), do: %{layer | review: Review.from_json(review)}

  @doc "Describes the changes of an entry in plain words."
  @spec describe_entry(Entry.t()) :: [String.t()]
  def describe_entry(%Entry{do: operation}) do
    schema = describe_schema(operation["schema"])

    changes =
      case parse_transaction(operation) do
        {:ok, transaction} -> Enum.map(transaction, &describe_change/1)
        :error -> []
      end

    schema ++ changes
  end

  defp describe_schema([%{} = before, %{} = later]) do
    {before, later} = {tier_names(before), tier_names(later)}

    case {before -- later, later -- before} do
      {[], []} ->
        ["change the schema"]

      {[from], [to]} when length(before) == length(later) ->
        ["rename tier #{from} to #{to}"]

      {removed, added} ->
        Enum.map(removed, &"remove tier #{&1}") ++ Enum.map(added, &"add tier #{&1}")
    end
  end

  defp describe_schema(nil), do: []
  defp describe_schema(_), do: ["change the schema"]

  defp tier_names(schema),
    do: for(%{"name" => name} <- List.wrap(schema["tiers"]), is_binary(name), do: name)

  defp describe_change({_id, nil, later}), do: "add #{describe_annotation(later)}"
  defp describe_change({_id, before, nil}), do: "delete #{describe_annotation(before)}"

  defp describe_change({_id, before, later}) do
    changes =
      for field <- changed_fields(before, later),
          do: describe_field(field, Map.fetch!(before, field), Map.fetch!(later, field))

    "change #{describe_annotation(before)}: #{Enum.join(changes, ", ")}"
  end

  defp describe_annotation(a) do
    values = a.values |> Enum.sort() |> Enum.map_join(" ", fn {_, v} -> to_string(v) end)
    kind = if a.proposed?, do: "proposal", else: "annotation"

    Enum.join(
      ["#{kind} #{values}" |> String.trim(), "on #{a.track}", "at #{show_time(a.from)}"],
      " "
    )
  end

  defp describe_field(field, before, later) when field in [:from, :to],
    do: "#{field} #{show_time(before)} to #{show_time(later)}"

  defp describe_field(:values, before, later) do
    for({key, value} <- later, before[key] != value, do: "#{key} = #{value}") |> Enum.join(", ")
  end

  defp describe_field(:proposed?, true, false), do: "accepted"
  defp describe_field(:proposed?, false, true), do: "proposed again"
  defp describe_field(field, _before, later), do: "#{field} = #{later}"

  defp show_time(time), do: time |> Situ.Time.to_iso8601() |> String.slice(11, 12)

  @doc "Returns the fields that differ between two annotations."
  @spec changed_fields(Annotation.t(), Annotation.t()) :: [atom()]
  def changed_fields(before, later) do
    for field <- [:from, :to, :track, :values, :by, :confidence, :note, :proposed?],
        Map.fetch!(before, field) != Map.fetch!(later, field),
        do: field
  end
end
