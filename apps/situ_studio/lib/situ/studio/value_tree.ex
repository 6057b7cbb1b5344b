defmodule Situ.Studio.ValueTree do
  @moduledoc false
  # Converts any term to a tree that a page can show: nodes `[kind, text, children | nil]`,
  # children `[key, node, path]`.
  #
  # The tree is bounded: deep, long or large values are truncated and marked. Texts are plain and
  # must not be interpreted as HTML.
  alias Situ.Studio.ValuePath

  @type tree :: [term()]

  @max_depth 8
  @max_children 100
  @max_text 400

  @doc """
  Builds the tree of `term`.

      iex> Situ.Studio.ValueTree.build(%{x: 1.5, on: true})
      ["map", "2 keys", [["on", ["boolean", "true", nil], ".on"], ["x", ["number", "1.5", nil], ".x"]]]
  """
  @spec build(term()) :: tree()
  def build(term), do: build_node(term, "", 0)

  @doc """
  Compares a tree with the tree of the message before: the texts of values that were different, by path, and the values
  that are gone.

      iex> alias Situ.Studio.ValueTree
      iex> [before, now] = Enum.map([%{x: 1, on: true, n: 0}, %{x: 2, on: true, y: 3}], &ValueTree.build/1)
      iex> ValueTree.list_changes(before, now)
      %{"gone" => [[".n", "0"]], "was" => %{".x" => "1", ".y" => nil}}
  """
  @spec list_changes(tree(), tree()) :: map()
  def list_changes(before, now) do
    {before, now} = {leaf_texts(before), leaf_texts(now)}

    %{
      "was" =>
        for({path, text} <- now, before[path] != text, into: %{}, do: {path, before[path]}),
      "gone" =>
        for({path, text} <- Enum.sort(before), not is_map_key(now, path), do: [path, text])
    }
  end

  # Values whose key cannot be written in a path are not compared.
  defp leaf_texts(tree), do: tree |> leaf_texts("", []) |> Map.new()

  defp leaf_texts(_, nil, texts), do: texts
  defp leaf_texts([_, text, nil], path, texts), do: [{path, text} | texts]

  defp leaf_texts([_, _, children], _, texts) do
    Enum.reduce(children, texts, fn [_, child, path], texts -> leaf_texts(child, path, texts) end)
  end

  defp build_node(term, _path, _depth) when is_number(term),
    do: ["number", format_number(term), nil]

  defp build_node(term, _, _) when is_boolean(term), do: ["boolean", Atom.to_string(term), nil]
  defp build_node(nil, _, _), do: ["atom", "nil", nil]
  defp build_node(term, _, _) when is_atom(term), do: ["atom", inspect(term), nil]
  defp build_node(term, _, _) when is_binary(term), do: binary_node(term)

  defp build_node(term, _, _) when is_bitstring(term),
    do: ["binary", "#{bit_size(term)} bits", nil]

  defp build_node(%module{} = struct, path, depth) do
    fields = struct |> Map.from_struct() |> Enum.sort_by(&field_order(elem(&1, 0)))
    build_branch("struct", inspect(module), fields, path, depth)
  end

  defp build_node(map, path, depth) when is_map(map) do
    entries = map |> Enum.take(@max_children + 1) |> Enum.sort()
    build_branch("map", pluralize(map_size(map), "key"), entries, path, depth)
  end

  defp build_node(list, path, depth) when is_list(list) do
    case proper_length(list, 0) do
      nil ->
        ["list", truncate(inspect(list, limit: 20, printable_limit: 100)), nil]

      n ->
        entries = list |> Enum.take(@max_children + 1) |> Enum.with_index(fn v, i -> {i, v} end)
        build_branch("list", pluralize(n, "element"), entries, path, depth)
    end
  end

  defp build_node(tuple, path, depth) when is_tuple(tuple) do
    entries = tuple |> Tuple.to_list() |> Enum.with_index(fn v, i -> {i, v} end)
    build_branch("tuple", "{#{tuple_size(tuple)}}", entries, path, depth)
  end

  defp build_node(other, _, _), do: ["other", truncate(inspect(other)), nil]

  defp build_branch(kind, text, _entries, _path, @max_depth), do: [kind, text <> " ...", nil]
  defp build_branch(kind, text, [], _path, _depth), do: [kind, text, nil]

  defp build_branch(kind, text, entries, path, depth) do
    {shown, more} = Enum.split(entries, @max_children)

    children =
      for {key, value} <- shown do
        # A child whose key cannot be written in a path can be shown but not plotted.
        child = path && ValuePath.child_path(path, key)
        [format_key(key), build_node(value, child, depth + 1), child]
      end

    more = if more == [], do: [], else: [["...", ["other", "more is not shown", nil], nil]]
    [kind, text, children ++ more]
  end

  defp binary_node(bytes) do
    if String.printable?(bytes, @max_text) and String.valid?(binary_part(bytes, 0, 0)) do
      ["string", truncate(inspect(bytes, printable_limit: @max_text)), nil]
    else
      ["binary", "#{byte_size(bytes)} bytes #{hex_preview(bytes)}", nil]
    end
  end

  defp hex_preview(bytes) do
    head = binary_part(bytes, 0, min(byte_size(bytes), 12))
    Base.encode16(head, case: :lower) <> if(byte_size(bytes) > 12, do: "...", else: "")
  end

  # Shows the most commonly needed fields first.
  defp field_order(key),
    do: {Enum.find_index([:x, :y, :width, :height, :label], &(&1 == key)) || 9, key}

  defp format_number(x) when is_integer(x), do: Integer.to_string(x)
  defp format_number(x), do: :erlang.float_to_binary(x, [:short])

  defp format_key(key) when is_atom(key), do: Atom.to_string(key)

  defp format_key(key) when is_binary(key),
    do: if(String.valid?(key), do: truncate(key), else: inspect(key))

  defp format_key(key) when is_integer(key), do: Integer.to_string(key)
  defp format_key(key), do: truncate(inspect(key))

  defp pluralize(1, noun), do: "1 " <> noun
  defp pluralize(n, noun), do: "#{n} #{noun}s"

  defp truncate(text) when byte_size(text) > @max_text,
    do: String.slice(text, 0, @max_text) <> "..."

  defp truncate(text), do: text

  defp proper_length([], n), do: n
  defp proper_length([_ | rest], n), do: proper_length(rest, n + 1)
  defp proper_length(_, _), do: nil
end
