defmodule Situ.Live.Test.Tree do
  @moduledoc false
  # Handles diffs as the browser's client does: merges them into a tree and converts the tree to HTML. Written from the
  # message grammar, not from `Situ.Live.Diff`, so that the two check each other.

  @type t :: map()

  @spec merge(t(), map()) :: t()
  def merge(tree, diff) do
    {islands, diff} = Map.pop(diff, "c", %{})
    tree = merge_root(tree, Map.drop(diff, ["e", "r", "t"]))
    old = Map.get(tree, "c", %{})

    merged =
      Map.new(islands, fn {cid, island} -> {cid, merge_root(Map.get(old, cid, %{}), island)} end)

    Map.put(tree, "c", Map.merge(old, merged))
  end

  # Static strings that were sent once replace the numbers that refer to them.
  defp merge_root(tree, diff) do
    {texts, diff} = Map.pop(diff, "p", %{})
    islands = Map.get(tree, "c")
    merged = node(Map.delete(tree, "c"), resolve(diff, texts))
    if islands, do: Map.put(merged, "c", islands), else: merged
  end

  defp resolve(%{} = diff, texts) do
    Map.new(diff, fn
      {"s", n} when is_integer(n) -> {"s", Map.fetch!(texts, Integer.to_string(n))}
      {"s", texts} -> {"s", texts}
      {"stream", stream} -> {"stream", stream}
      {key, value} -> {key, resolve(value, texts)}
    end)
  end

  defp resolve([index, %{} = diff], texts), do: [index, resolve(diff, texts)]
  defp resolve(value, _), do: value

  defp node(_old, %{"s" => _} = new), do: new
  defp node(%{} = old, %{"k" => keyed} = diff), do: keyed(old, keyed, diff)

  defp node(%{} = old, %{} = diff) do
    Enum.reduce(diff, old, fn {key, value}, acc ->
      Map.update(acc, key, value, &node(&1, value))
    end)
  end

  defp node(_old, new), do: new

  defp keyed(old, keyed, diff) do
    {count, keyed} = Map.pop!(keyed, "kc")
    {moved?, keyed} = Map.pop(keyed, "km", false)
    before = Map.get(old, "k", %{})

    if not moved? and Enum.any?(keyed, fn {_, entry} -> not is_map(entry) end),
      do: raise(ArgumentError, "an entry moved, but km is not set")

    entries =
      Enum.reduce(keyed, before, fn
        {i, [from, change]}, acc -> Map.put(acc, i, node(before["#{from}"], change))
        {i, from}, acc when is_integer(from) -> Map.put(acc, i, Map.fetch!(before, "#{from}"))
        {i, change}, acc -> Map.update(acc, i, change, &node(&1, change))
      end)

    kept = for i <- 0..(count - 1)//1, into: %{}, do: {"#{i}", Map.fetch!(entries, "#{i}")}
    old |> Map.put("k", Map.put(kept, "kc", count)) |> stream(diff)
  end

  defp stream(tree, %{"stream" => stream}), do: Map.put(tree, "stream", stream)
  defp stream(tree, _), do: tree

  @doc """
  Returns the HTML of the tree. `rows` maps a stream's ref to its rows, which belong to the page, not the tree.
  """
  @spec html(t()) :: String.t()
  def html(tree), do: tree |> out(Map.get(tree, "c", %{}), &entries/2) |> IO.iodata_to_binary()

  @spec html(t(), %{optional(String.t()) => [{String.t(), String.t()}]}) :: String.t()
  def html(tree, rows) do
    kept = fn
      %{"stream" => [ref | _]}, _islands -> for {_id, html} <- Map.get(rows, ref, []), do: html
      node, islands -> entries(node, islands)
    end

    tree |> out(Map.get(tree, "c", %{}), kept) |> IO.iodata_to_binary()
  end

  defp out(text, _, _) when is_binary(text), do: text
  defp out(cid, islands, list) when is_integer(cid), do: islands["#{cid}"] |> out(islands, list)
  defp out(%{"k" => _} = node, islands, list), do: list.(node, islands)
  defp out(%{"s" => texts} = node, islands, list), do: weave(texts, node, 0, islands, list)

  defp entries(%{"k" => keyed, "s" => texts}, islands) do
    for i <- 0..(keyed["kc"] - 1)//1, do: weave(texts, keyed["#{i}"], 0, islands, &entries/2)
  end

  defp weave([text], _node, _, _, _), do: [text]

  defp weave([text | texts], node, i, islands, list) do
    value = Map.fetch!(node, Integer.to_string(i))
    [text, out(value, islands, list) | weave(texts, node, i + 1, islands, list)]
  end

  @doc "Returns the stream inserts and deletes of the tree, with the rows' HTML; call it once after each merge."
  @spec streams(t()) :: [{[term()], [String.t()]}]
  def streams(tree) do
    for %{"stream" => stream} = node <- nodes(tree) do
      {stream, Enum.map(entries(node, Map.get(tree, "c", %{})), &IO.iodata_to_binary/1)}
    end
  end

  @doc "Removes the stream entries, which have been applied."
  @spec drained(t()) :: t()
  def drained(%{"stream" => [ref | _], "k" => _} = node),
    do: %{node | "k" => %{"kc" => 0}, "stream" => [ref, [], []]}

  def drained(%{} = node), do: Map.new(node, fn {key, value} -> {key, drained(value)} end)
  def drained(value), do: value

  defp nodes(%{} = node), do: [node | Enum.flat_map(node, fn {_, value} -> nodes(value) end)]
  defp nodes(_), do: []
end
