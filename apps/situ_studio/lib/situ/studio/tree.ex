defmodule Situ.Studio.Tree do
  @moduledoc false
  # Arranges stream names as a tree: `Camera.Left.Image` is `Image` under `Left` under `Camera`. A
  # name may be both a stream and a group. Pure.

  alias Situ.Studio.NaturalOrder

  defmodule Row do
    @moduledoc false
    # Represents a row of the tree. `item` is `nil` for a group without a stream; `open?` is `nil`
    # for a leaf; `under` contains the items below it.
    @enforce_keys [:path, :label, :depth]
    defstruct [:path, :label, :depth, :item, :open?, under: []]

    @type t :: %__MODULE__{
            path: String.t(),
            label: String.t(),
            depth: non_neg_integer(),
            item: term(),
            open?: boolean() | nil,
            under: [term()]
          }
  end

  @type t :: %{optional(String.t()) => {item :: term(), t()}}

  @doc """
  Builds the tree of `items`; `name` returns an item's dotted name.

      iex> tree = Situ.Studio.Tree.build(["A.x", "A.y", "B"], & &1)
      iex> for row <- Situ.Studio.Tree.visible_rows(tree, MapSet.new()), do: {row.depth, row.label, row.item}
      [{0, "A", nil}, {1, "x", "A.x"}, {1, "y", "A.y"}, {0, "B", "B"}]
  """
  @spec build([item], (item -> String.t())) :: t() when item: term()
  def build(items, name) do
    Enum.reduce(items, %{}, fn item, tree -> put_item(tree, split_name(name.(item)), item) end)
  end

  defp put_item(tree, [last], item) do
    Map.update(tree, last, {item, %{}}, fn {_, children} -> {item, children} end)
  end

  defp put_item(tree, [first | rest], item) do
    {own, children} = Map.get(tree, first, {nil, %{}})
    Map.put(tree, first, {own, put_item(children, rest, item)})
  end

  # Names with empty segments, such as "a..b" and ".a", are not split, so that nothing is hidden.
  # Dots in an expression are not separators.
  defp split_name("= " <> _ = name), do: [name]

  defp split_name(name) do
    parts = String.split(name, ".")
    if "" in parts, do: [name], else: parts
  end

  @doc "Returns the visible rows in order; the paths in `closed` hide everything below them."
  @spec visible_rows(t(), MapSet.t(String.t())) :: [Row.t()]
  def visible_rows(tree, closed), do: tree |> collect_rows("", 0, closed) |> List.flatten()

  defp collect_rows(tree, prefix, depth, closed) do
    for {label, {item, children}} <- Enum.sort_by(tree, &NaturalOrder.sort_key(elem(&1, 0))) do
      path = prefix <> label
      leaf? = children == %{}
      open? = if leaf?, do: nil, else: path not in closed

      row = %Row{
        path: path,
        label: label,
        depth: depth,
        item: item,
        open?: open?,
        under: list_items(children)
      }

      [row | if(open?, do: collect_rows(children, path <> ".", depth + 1, closed), else: [])]
    end
  end

  defp list_items(tree) do
    Enum.flat_map(tree, fn {_, {item, children}} -> List.wrap(item) ++ list_items(children) end)
  end

  @doc """
  Returns the items whose text contains every word of `query`, ignoring case.

      iex> Situ.Studio.Tree.search(["Camera.Image", "Mic.Audio"], "ima cam", & &1)
      ["Camera.Image"]
  """
  @spec search([item], String.t(), (item -> String.t())) :: [item] when item: term()
  def search(items, query, text) do
    words = query |> String.downcase() |> String.split()

    Enum.filter(items, fn item ->
      text = String.downcase(text.(item))
      Enum.all?(words, &String.contains?(text, &1))
    end)
  end
end
