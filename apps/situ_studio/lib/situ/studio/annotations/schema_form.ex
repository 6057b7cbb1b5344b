defmodule Situ.Studio.Annotations.SchemaForm do
  @moduledoc false
  # Holds the schema of a stream of annotations while users edit it in the page: attributes, and
  # their values with keys and colors. Attributes and values remember their original names, so
  # that annotations follow renames.
  alias Situ.Annotation.Schema
  alias Situ.Error

  @kinds ~w(finite text number bool)
  @most 64

  @type value :: %{value: String.t(), key: String.t(), fill: String.t(), was: String.t() | nil}
  @type attribute :: %{
          name: String.t(),
          kind: String.t(),
          was: String.t() | nil,
          values: [value()]
        }
  @typedoc "The old and new name of each attribute, with a map from old to new names of its values."
  @type renamed :: [{String.t(), String.t(), %{String.t() => String.t()}}]

  @doc """
  Converts a schema to a draft that can be edited.

      iex> alias Situ.Studio.Annotations.SchemaForm
      iex> {:ok, schema} = Situ.Annotation.Schema.parse(%{"name" => "S", "attributes" => [
      ...>   %{"name" => "Speech", "kind" => "finite", "values" => [%{"value" => "speaks", "key" => "1"}]}]})
      iex> draft = SchemaForm.from_schema(schema)
      iex> draft = SchemaForm.update_from_params(draft, %{"0" => %{"name" => "Voice", "kind" => "finite",
      ...>   "values" => %{"0" => %{"value" => "talks", "key" => "t", "fill" => "#ff0000"}}}})
      iex> {:ok, schema, renamed} = SchemaForm.build_schema(schema, draft)
      iex> {hd(schema.attributes).values, renamed}
      {[%{fill: "#ff0000", key: "t", text: nil, value: "talks"}], [{"Speech", "Voice", %{"speaks" => "talks"}}]}
  """
  @spec from_schema(Schema.t()) :: [attribute()]
  def from_schema(%Schema{attributes: attributes}) do
    for a <- attributes do
      values =
        for v <- a.values,
            do: %{value: v.value, key: v.key || "", fill: v.fill || "", was: v.value}

      %{name: a.name, kind: Atom.to_string(a.kind), was: a.name, values: values}
    end
  end

  @doc "Updates the draft with the values of the page's fields."
  @spec update_from_params([attribute()], map()) :: [attribute()]
  def update_from_params(draft, params) do
    for {attribute, i} <- Enum.with_index(draft) do
      fields = nested_params(params, i)
      values = nested_params(fields, "values")

      %{
        attribute
        | name: text_param(fields["name"], attribute.name),
          kind: if(fields["kind"] in @kinds, do: fields["kind"], else: attribute.kind),
          values:
            for(
              {v, k} <- Enum.with_index(attribute.values),
              do: update_value(v, nested_params(values, k))
            )
      }
    end
  end

  defp update_value(value, fields) do
    %{
      value
      | value: text_param(fields["value"], value.value),
        key: fields["key"] |> text_param(value.key) |> String.slice(0, 1),
        fill: text_param(fields["fill"], value.fill)
    }
  end

  defp nested_params(params, key) do
    case params do
      %{} -> if is_map(params[to_string(key)]), do: params[to_string(key)], else: %{}
      _ -> %{}
    end
  end

  defp text_param(text, old),
    do: if(is_binary(text), do: String.slice(text, 0, 100), else: old)

  @doc "Adds an empty attribute, or an empty value to the attribute at `index`."
  @spec add_entry([attribute()], :attribute | non_neg_integer()) :: [attribute()]
  def add_entry(draft, :attribute) when length(draft) < @most,
    do: draft ++ [%{name: "", kind: "finite", was: nil, values: [empty_value()]}]

  def add_entry(draft, index) when is_integer(index) do
    more =
      &if(length(&1.values) < @most, do: %{&1 | values: &1.values ++ [empty_value()]}, else: &1)

    if index < length(draft), do: List.update_at(draft, index, more), else: draft
  end

  def add_entry(draft, _), do: draft

  defp empty_value, do: %{value: "", key: "", fill: "", was: nil}

  @doc "Removes the attribute at `index`, or its value at `nth`."
  @spec remove_entry([attribute()], non_neg_integer(), non_neg_integer() | nil) :: [attribute()]
  def remove_entry(draft, index, nil), do: List.delete_at(draft, index)

  def remove_entry(draft, index, nth) do
    if index < length(draft),
      do: List.update_at(draft, index, &%{&1 | values: List.delete_at(&1.values, nth)}),
      else: draft
  end

  @doc """
  Builds the schema from a draft and lists the renames. Attributes and values without a name are left out. The tiers of
  the old schema follow the renames.
  """
  @spec build_schema(Schema.t(), [attribute()]) ::
          {:ok, Schema.t(), renamed()} | {:error, Error.t()}
  def build_schema(%Schema{} = old, draft) do
    draft = Enum.reject(draft, &(String.trim(&1.name) == ""))

    json =
      Map.merge(Schema.to_json(old), %{
        "attributes" => Enum.map(draft, &attribute_to_json/1),
        "tiers" => rename_tiers(old, draft)
      })

    with {:ok, schema} <- Schema.parse(json) do
      renamed =
        for %{was: was} = a when was != nil <- draft,
            values = for(v <- a.values, v.was, v.was != v.value, into: %{}, do: {v.was, v.value}),
            was != a.name or values != %{},
            do: {was, a.name, values}

      {:ok, schema, renamed}
    end
  end

  defp rename_tiers(old, draft) do
    names = Map.new(draft, &{&1.was, String.trim(&1.name)})

    for tier <- Schema.to_json(old)["tiers"] || [],
        do: Map.update!(tier, "attribute", &Map.get(names, &1, &1))
  end

  defp attribute_to_json(%{kind: "finite"} = a) do
    values = for v <- a.values, String.trim(v.value) != "", do: value_to_json(v)
    %{"name" => String.trim(a.name), "kind" => "finite", "values" => values}
  end

  defp attribute_to_json(a), do: %{"name" => String.trim(a.name), "kind" => a.kind}

  defp value_to_json(v) do
    %{"value" => String.trim(v.value), "key" => v.key, "fill" => v.fill}
    |> Map.reject(fn {_, text} -> text == "" end)
  end
end
