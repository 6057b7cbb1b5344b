defmodule Situ.Studio.Annotations.TierText do
  @moduledoc false
  # Parses the tiers of a new layer from text, one line per tier: its name, its relation to a parent, and its values.
  alias Situ.Annotation.Schema

  @relations [
    {" parts of ", "symbolic_subdivision"},
    {" divides ", "time_subdivision"},
    {" of ", "symbolic_association"},
    {" in ", "included_in"}
  ]

  @doc """
  Parses the schema. `A in B` is inside, `A divides B` divides its time, `A parts of B` divides it into equal parts, and
  `A of B` is one annotation for each of B. A tier has texts, or the values after a colon.

      iex> text = "Utterance\\nWords in Utterance\\nKind of Words: noun, verb"
      iex> {:ok, schema} = Situ.Studio.Annotations.TierText.parse_schema("Speech", text)
      iex> for tier <- schema.tiers, do: {tier.name, tier.relation, tier.parent}
      [{"Utterance", nil, nil}, {"Words", :included_in, "Utterance"}, {"Kind", :symbolic_association, "Words"}]
      iex> Enum.map(List.last(schema.attributes).values, & &1.value)
      ["noun", "verb"]
  """
  @spec parse_schema(String.t(), String.t()) :: {:ok, Schema.t()} | {:error, Situ.Error.t()}
  def parse_schema(name, text) do
    lines = for line <- String.split(text, "\n"), String.trim(line) != "", do: parse_line(line)

    Schema.parse(%{
      "name" => name,
      "attributes" => Enum.map(lines, &elem(&1, 0)),
      "tiers" => Enum.map(lines, &elem(&1, 1))
    })
  end

  defp parse_line(line) do
    {head, values} = split_once(line, ":")
    {name, parent, relation} = parse_relation(String.trim(head))
    tier = %{"name" => name, "attribute" => name, "parent" => parent, "relation" => relation}

    case for value <- String.split(values, ","),
             value = String.trim(value),
             value != "",
             do: value do
      [] -> {%{"name" => name, "kind" => "text"}, tier}
      values -> {%{"name" => name, "kind" => "finite", "values" => values}, tier}
    end
  end

  defp split_once(text, mark) do
    case String.split(text, mark, parts: 2) do
      [head, rest] -> {head, rest}
      [head] -> {head, ""}
    end
  end

  defp parse_relation(text) do
    Enum.find_value(@relations, {text, nil, nil}, fn {word, relation} ->
      case String.split(text, word, parts: 2) do
        [name, parent] -> {String.trim(name), String.trim(parent), relation}
        [_] -> nil
      end
    end)
  end
end
