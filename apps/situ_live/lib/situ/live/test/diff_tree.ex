defmodule Situ.Live.Test.DiffTree do
  @moduledoc false
  # Handles diffs as the browser's client does: merges them into a tree and converts the tree to HTML. Written from the
  # message grammar, not from `Situ.Live.Diff`, so that the two check each other.

  @type t :: map()

  @spec merge_diff(t(), map()) :: t()
  def merge_diff(tree, diff) do
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
    merged = merge_node(Map.delete(tree, "c"), resolve_statics(diff, texts))
    if islands, do: Map.put(merged, "c", islands), else: merged
  end

  defp resolve_statics(%{} = diff, texts) do
    Map.new(diff, fn
      {"s", n} when is_integer(n) -> {"s", Map.fetch!(texts, Integer.to_string(n))}
      {"s", texts} -> {"s", texts}
      {"stream", stream} -> {"stream", stream}
      {key, value} -> {key, resolve_statics(value, texts)}
    end)
  end

  defp resolve_statics([index, %{} = diff], texts), do: [index, resolve_statics(diff, texts)]
  defp resolve_statics(value, _), do: value

  defp merge_node(_old, %{"s" => _} = new), do: new
  defp merge_node(%{} = old, %{"k" => keyed} = diff), do: merge_keyed(old, keyed, diff)

  defp merge_node(%{} = old, %{} = diff) do
    Enum.reduce(diff, old, fn {key, value}, acc ->
      Map.update(acc, key, value, &merge_node(&1, value))
    end)
  end

  defp merge_node(_old, new), do: new

  defp merge_keyed(old, keyed, diff) do
    {count, keyed} = Map.pop!(keyed, "kc")
    {moved?, keyed} = Map.pop(keyed, "km", false)
    old_entries = Map.get(old, "k", %{})

    if not moved? and Enum.any?(keyed, fn {_, entry} -> not is_map(entry) end),
      do: raise(ArgumentError, "an entry moved, but km is not set")

    entries =
      Enum.reduce(keyed, old_entries, fn
        {i, [from, change]}, acc ->
          Map.put(acc, i, merge_node(old_entries["#{from}"], change))

        {i, from}, acc when is_integer(from) ->
          Map.put(acc, i, Map.fetch!(old_entries, "#{from}"))

        {i, change}, acc ->
          Map.update(acc, i, change, &merge_node(&1, change))
      end)

    remaining = for i <- 0..(count - 1)//1, into: %{}, do: {"#{i}", Map.fetch!(entries, "#{i}")}
    old |> Map.put("k", Map.put(remaining, "kc", count)) |> put_stream(diff)
  end

  defp put_stream(tree, %{"stream" => stream}), do: Map.put(tree, "stream", stream)
  defp put_stream(tree, _), do: tree

  @doc """
  Returns the HTML of the tree. `rows` maps a stream's ref to its rows, which belong to the page, not the tree.
  """
  @spec to_html(t()) :: String.t()
  def to_html(tree),
    do: tree |> render_node(Map.get(tree, "c", %{}), &render_entries/2) |> IO.iodata_to_binary()

  @spec to_html(t(), %{optional(String.t()) => [{String.t(), String.t()}]}) :: String.t()
  def to_html(tree, rows) do
    render_list = fn
      %{"stream" => [ref | _]}, _islands -> for {_id, html} <- Map.get(rows, ref, []), do: html
      node, islands -> render_entries(node, islands)
    end

    tree |> render_node(Map.get(tree, "c", %{}), render_list) |> IO.iodata_to_binary()
  end

  defp render_node(text, _, _) when is_binary(text), do: text

  defp render_node(cid, islands, render_list) when is_integer(cid),
    do: islands["#{cid}"] |> render_node(islands, render_list)

  defp render_node(%{"k" => _} = node, islands, render_list), do: render_list.(node, islands)

  defp render_node(%{"s" => texts} = node, islands, render_list),
    do: interleave_values(texts, node, 0, islands, render_list)

  defp render_entries(%{"k" => keyed, "s" => texts}, islands) do
    for i <- 0..(keyed["kc"] - 1)//1,
        do: interleave_values(texts, keyed["#{i}"], 0, islands, &render_entries/2)
  end

  defp interleave_values([text], _node, _, _, _), do: [text]

  defp interleave_values([text | texts], node, i, islands, render_list) do
    value = Map.fetch!(node, Integer.to_string(i))

    [
      text,
      render_node(value, islands, render_list)
      | interleave_values(texts, node, i + 1, islands, render_list)
    ]
  end

  @doc "Returns the stream inserts and deletes of the tree, with the rows' HTML; call it once after each merge."
  @spec stream_updates(t()) :: [{[term()], [String.t()]}]
  def stream_updates(tree) do
    for %{"stream" => stream} = node <- collect_nodes(tree) do
      {stream, Enum.map(render_entries(node, Map.get(tree, "c", %{})), &IO.iodata_to_binary/1)}
    end
  end

  @doc "Removes the stream entries, which have been applied."
  @spec clear_streams(t()) :: t()
  def clear_streams(%{"stream" => [ref | _], "k" => _} = node),
    do: %{node | "k" => %{"kc" => 0}, "stream" => [ref, [], []]}

  def clear_streams(%{} = node),
    do: Map.new(node, fn {key, value} -> {key, clear_streams(value)} end)

  def clear_streams(value), do: value

  defp collect_nodes(%{} = node),
    do: [node | Enum.flat_map(node, fn {_, value} -> collect_nodes(value) end)]

  defp collect_nodes(_), do: []
end
