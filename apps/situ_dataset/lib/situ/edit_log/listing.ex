defmodule Situ.EditLog.Listing do
  @moduledoc false
  # Lists whose items have keys: objects with different names or ids, or different strings. `Situ.EditLog.Changes`
  # describes the changes.
  alias Situ.EditLog.Changes

  @doc "Returns whether two lists have keys of the same kind."
  @spec keyed?(list(), list()) :: boolean()
  def keyed?(before, later) do
    case {item_kind(before), item_kind(later)} do
      {:none, _} -> false
      {_, :none} -> false
      {:empty, kind} -> kind != :empty
      {_kind, :empty} -> true
      {kind, other} -> kind == other
    end
  end

  defp item_kind([]), do: :empty

  defp item_kind(list) do
    cond do
      Enum.all?(list, &has_text?(&1, "name")) -> check_unique(list, :named)
      Enum.all?(list, &has_text?(&1, "id")) -> check_unique(list, :numbered)
      Enum.all?(list, &is_binary/1) -> check_unique(list, :strings)
      true -> :none
    end
  end

  defp has_text?(item, key), do: is_map(item) and is_binary(item[key])

  defp check_unique(list, kind),
    do:
      if(list |> MapSet.new(&item_key/1) |> MapSet.size() == length(list), do: kind, else: :none)

  defp item_key(%{name: name}), do: name
  defp item_key(%{"name" => name}), do: name
  defp item_key(%{"id" => id}), do: id
  defp item_key(text), do: text

  @doc """
  Returns the changes between two lists. `diff` compares two items with the same key. Items may be structs with a
  `name`; `to_json` then converts an item.
  """
  @spec diff(
          list(),
          list(),
          Changes.path(),
          (term(), term(), Changes.path() -> [Changes.change()]),
          (term() -> term())
        ) ::
          [Changes.change()]
  def diff(before, later, path, diff, to_json \\ & &1) do
    with :other_keys <- diff_pairs(before, later, path, {diff, to_json}, []),
         do: diff_keys(before, later, path, {diff, to_json})
  end

  # Most edits leave the keys alone, and compare nearly all items by their address in memory.
  defp diff_pairs([], [], _path, _tools, done), do: Enum.concat(Enum.reverse(done))

  defp diff_pairs([same | before], [same | later], path, tools, done),
    do: diff_pairs(before, later, path, tools, done)

  defp diff_pairs([a | before], [b | later], path, tools, done) do
    if item_key(a) == item_key(b) do
      changes = diff_items(a, b, path, tools)
      diff_pairs(before, later, path, tools, [changes | done])
    else
      :other_keys
    end
  end

  # Items were added at the end.
  defp diff_pairs([], added, path, {_diff, to_json}, done) do
    adds = for item <- added, do: ["add", path ++ [item_key(item)], to_json.(item), nil]
    Enum.concat(Enum.reverse([adds | done]))
  end

  defp diff_pairs(_before, _later, _path, _tools, _done), do: :other_keys

  defp diff_keys(before, later, path, {_diff, to_json} = tools) do
    old = Map.new(before, &{item_key(&1), &1})
    new = Map.new(later, &{item_key(&1), &1})

    removed =
      for {item, i} <- Enum.with_index(before), not is_map_key(new, item_key(item)), do: {item, i}

    added =
      for {item, i} <- Enum.with_index(later), not is_map_key(old, item_key(item)), do: {item, i}

    {renames, removed, added} = find_renames(removed, added)

    changes =
      for({a, b} <- renames, do: ["rename", path ++ [item_key(a)], item_key(a), item_key(b)]) ++
        for(
          {a, i} <- Enum.reverse(removed),
          do: ["remove", path ++ [item_key(a)], to_json.(a), i]
        ) ++
        for({b, i} <- added, do: ["add", path ++ [item_key(b)], to_json.(b), i]) ++
        for key <- Enum.map(before, &item_key/1),
            %{^key => b} <- [new],
            change <- diff_items(old[key], b, path, tools),
            do: change

    changes ++ diff_order(Enum.map(before, &item_key/1), later, {path, changes})
  end

  defp diff_items(a, b, path, {diff, to_json}),
    do: diff.(to_json.(a), to_json.(b), path ++ [item_key(b)])

  defp diff_order(keys, later, {path, changes}) do
    moved =
      Enum.reduce(changes, keys, fn
        ["rename", at, from, to], keys when length(at) == length(path) + 1 ->
          Enum.map(keys, &if(&1 == from, do: to, else: &1))

        ["remove", at, _, _], keys when length(at) == length(path) + 1 ->
          List.delete(keys, List.last(at))

        ["add", at, _, i], keys when length(at) == length(path) + 1 ->
          List.insert_at(keys, i, List.last(at))

        _, keys ->
          keys
      end)

    wanted = Enum.map(later, &item_key/1)
    if moved == wanted, do: [], else: [["order", path, moved, wanted]]
  end

  # An item with a new name and the same content was renamed.
  defp find_renames(removed, added) do
    Enum.reduce(removed, {[], [], added}, fn {item, i}, {renames, rest, added} ->
      case Enum.find(added, fn {b, _} -> same_content?(item, b) end) do
        nil -> {renames, rest ++ [{item, i}], added}
        {b, _} = found -> {renames ++ [{item, b}], rest, List.delete(added, found)}
      end
    end)
  end

  defp same_content?(%{"name" => _} = a, b), do: Map.delete(a, "name") == Map.delete(b, "name")
  defp same_content?(%{name: _} = a, b), do: %{a | name: nil} == %{b | name: nil}
  defp same_content?(_, _), do: false

  @doc "Applies a change of the list's keys."
  @spec apply_change(list(), Changes.change()) :: {:ok, list()} | :conflict
  def apply_change(list, ["add", [key], value, index]) do
    case fetch_item(list, key) do
      :error -> {:ok, insert_item(list, value, index)}
      {:ok, ^value} -> {:ok, list}
      _ -> :conflict
    end
  end

  def apply_change(list, ["remove", [key], value, _index]) do
    case fetch_item(list, key) do
      {:ok, ^value} -> {:ok, Enum.reject(list, &(item_key(&1) == key))}
      :error -> {:ok, list}
      _ -> :conflict
    end
  end

  def apply_change(list, ["order", [], _before, keys]) do
    by_key = Map.new(list, &{item_key(&1), &1})
    ordered = for key <- keys, %{^key => item} <- [by_key], do: item
    {:ok, ordered ++ Enum.reject(list, &(item_key(&1) in keys))}
  end

  def apply_change(_list, _change), do: :conflict

  @doc "Inserts an item at an index; `nil` is the end."
  @spec insert_item(list(), term(), non_neg_integer() | nil) :: list()
  def insert_item(list, item, nil), do: list ++ [item]
  def insert_item(list, item, index), do: List.insert_at(list, index, item)

  @doc "Returns the item with a key."
  @spec fetch_item(list(), String.t()) :: {:ok, term()} | :error
  def fetch_item([], _key), do: :error

  def fetch_item([item | rest], key),
    do: if(item_key(item) == key, do: {:ok, item}, else: fetch_item(rest, key))

  @doc "Replaces the item with a key."
  @spec replace_item(list(), String.t(), term()) :: list()
  def replace_item(list, key, new) do
    {:ok, list} = update_item(list, key, fn _ -> {:ok, new} end)
    list
  end

  @doc """
  Changes the item with a key by a function `item -> {:ok, item} | other`. Returns `other`, or `:conflict` without such
  an item.
  """
  @spec update_item(list(), String.t(), (term() -> {:ok, term()} | other)) ::
          {:ok, list()} | :conflict | other
        when other: term()
  def update_item(list, key, fun), do: update_item(list, key, fun, [])

  defp update_item([], _key, _fun, _before), do: :conflict

  defp update_item([item | rest], key, fun, before) do
    if item_key(item) == key do
      with {:ok, item} <- fun.(item), do: {:ok, :lists.reverse(before, [item | rest])}
    else
      update_item(rest, key, fun, [item | before])
    end
  end

  @doc "Renames an item, unless its new key exists."
  @spec rename_item(list(), String.t(), {String.t(), (term() -> term())}) ::
          {:ok, list()} | :conflict
  def rename_item(list, from, {to, rename}) do
    case {fetch_item(list, from), fetch_item(list, to)} do
      {{:ok, item}, :error} -> {:ok, replace_item(list, from, rename.(item))}
      {:error, {:ok, _}} -> {:ok, list}
      _ -> :conflict
    end
  end
end
