defmodule Situ.Annotation.TierText do
  @moduledoc false
  # Parses tiers from text, one line per tier: its name, its relation to a parent, and its values.
  alias Situ.Annotation.{Schema, Tier}

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
      iex> {:ok, schema} = Situ.Annotation.TierText.parse_schema("Speech", text)
      iex> for tier <- schema.tiers, do: {tier.name, tier.relation, tier.parent}
      [{"Utterance", nil, nil}, {"Words", :included_in, "Utterance"}, {"Kind", :symbolic_association, "Words"}]
      iex> Enum.map(List.last(schema.attributes).values, & &1.value)
      ["noun", "verb"]
  """
  @spec parse_schema(String.t(), String.t()) :: {:ok, Schema.t()} | {:error, Situ.Error.t()}
  def parse_schema(name, text) do
    lines = for line <- String.split(text, "\n"), String.trim(line) != "", do: parse_tier(line)

    Schema.parse(%{
      "name" => name,
      "attributes" => Enum.map(lines, &elem(&1, 0)),
      "tiers" => Enum.map(lines, &elem(&1, 1))
    })
  end

  @doc "Parses one line to the JSON forms of an attribute and of its tier."
  @spec parse_tier(String.t()) :: {attribute :: map(), tier :: map()}
  def parse_tier(line) do
    {head, values} = split_once(line, ":")
    {name, parent, relation} = parse_relation(String.trim(head))
    tier = %{"name" => name, "attribute" => name, "parent" => parent, "relation" => relation}

    case split_values(values) do
      [] -> {%{"name" => name, "kind" => "text"}, tier}
      values -> {%{"name" => name, "kind" => "finite", "values" => values}, tier}
    end
  end

  @doc "Splits the values of a vocabulary at commas."
  @spec split_values(String.t()) :: [String.t()]
  def split_values(text),
    do: text |> String.split(",") |> Enum.map(&String.trim/1) |> Enum.reject(&(&1 == ""))

  @doc "Describes a tier without its values, as `parse_tier/1` reads it."
  @spec format_tier(Tier.t()) :: String.t()
  def format_tier(%Tier{parent: nil, name: name}), do: name

  def format_tier(%Tier{} = tier) do
    {word, _} = Enum.find(@relations, &(elem(&1, 1) == Atom.to_string(tier.relation)))
    tier.name <> word <> tier.parent
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
