defmodule Situ.Studio.Layout.TreeJson do
  @moduledoc false
  # Converts the tree of a layout to and from JSON values. A panel without a size is its id. Untrusted, and possibly
  # merged from the changes of several people: missing panels are added below, and unknown ones are left out.
  alias Situ.Studio.Layout.Tree

  @ways %{"row" => :row, "column" => :column, "tabs" => :tabs}
  @id ~r/\As[0-9]{1,4}\z/
  @max_depth 12

  @doc "Encodes a tree."
  @spec encode(Tree.t() | nil) :: term()
  def encode(nil), do: nil
  def encode(%Tree{way: :panel, id: id, size: nil}), do: id
  def encode(%Tree{way: :panel, id: id, size: size}), do: %{"panel" => id, "size" => size}

  def encode(%Tree{way: way, id: id} = tree) do
    %{"id" => id, Atom.to_string(way) => Enum.map(tree.parts, &encode/1)}
    |> put_present("size", tree.size)
    |> put_present("active", tree.active)
  end

  defp put_present(map, _, nil), do: map
  defp put_present(map, key, value), do: Map.put(map, key, value)

  @doc """
  Parses the tree of these panels.

      iex> alias Situ.Studio.Layout.{Tree, TreeJson}
      iex> {:ok, tree} = TreeJson.parse(%{"id" => "s1", "row" => ["p2", "p1", "p9"]}, ["p1", "p2", "p3"])
      iex> Tree.to_list(tree)
      [:column, [:row, "p2", "p1"], "p3"]
      iex> TreeJson.parse(%{"id" => "s1", "row" => 7}, ["p1"])
      {:error, "a part of its tree is neither a panel nor a row, a column or tabs"}
  """
  @spec parse(term(), [String.t()]) :: {:ok, Tree.t() | nil} | {:error, why :: String.t()}
  def parse(json, ids) do
    {tree, {left, _}} = read_part(json || ids_below(ids), {MapSet.new(ids), MapSet.new()}, 0)
    lacking = for id <- ids, id in left, do: Tree.new_panel(id)

    case {Tree.simplify(tree), lacking} do
      {nil, lacking} -> {:ok, Tree.combine(:column, lacking)}
      {tree, []} -> {:ok, tree}
      {tree, lacking} -> {:ok, Tree.combine(:column, [tree | lacking])}
    end
  catch
    {:bad_tree, why} -> {:error, why}
  end

  defp ids_below(ids), do: %{"id" => "s1", "column" => ids}

  defp read_part(_, _, @max_depth), do: throw({:bad_tree, "its tree is too deep"})

  defp read_part(id, seen, depth) when is_binary(id),
    do: read_part(%{"panel" => id}, seen, depth)

  # A panel that does not exist, or that occurs twice, is left out.
  defp read_part(%{"panel" => id} = doc, {left, taken}, _) do
    if id in left,
      do:
        {%{Tree.new_panel(id) | size: read_size(doc["size"])}, {MapSet.delete(left, id), taken}},
      else: {nil, {left, taken}}
  end

  defp read_part(%{"id" => id} = doc, {left, taken}, depth) when is_binary(id) do
    with {_, parts, way} when is_list(parts) <- find_way(doc),
         true <- id =~ @id and id not in taken do
      seen = {left, MapSet.put(taken, id)}
      {parts, seen} = Enum.map_reduce(parts, seen, &read_part(&1, &2, depth + 1))
      tree = %Tree{id: id, way: way, parts: Enum.reject(parts, &is_nil/1)}
      {%{tree | size: read_size(doc["size"]), active: read_active(doc["active"])}, seen}
    else
      false -> throw({:bad_tree, "two parts of its tree have the id #{inspect(id)}"})
      _ -> bad_part()
    end
  end

  defp read_part(_, _, _), do: bad_part()

  defp bad_part,
    do: throw({:bad_tree, "a part of its tree is neither a panel nor a row, a column or tabs"})

  defp find_way(doc),
    do: Enum.find_value(@ways, fn {key, way} -> if doc[key], do: {key, doc[key], way} end)

  defp read_size(size) when is_number(size) and size >= 1 and size <= 2_000, do: size
  defp read_size(_), do: nil

  defp read_active(id) when is_binary(id), do: id
  defp read_active(_), do: nil
end
