defmodule Situ.EditLog.Changes do
  @moduledoc false
  # The operations on a JSON document: the differences of two states as a list of changes, each of which names its place
  # by a path. Changes at different places commute. If another program has changed a place in a different way, a
  # change of this place is a conflict.
  #
  # A path is a list of keys. In a list of objects with names or ids, such as the sessions of a dataset, the key is the
  # name or id. In a list of different strings, such as tags, it is the string. Any other list is one value.
  #
  #     ["add", PATH, VALUE, INDEX]  ["remove", PATH, VALUE, INDEX]  ["set", PATH, BEFORE, AFTER]
  #     ["rename", PATH, BEFORE, AFTER]  ["order", PATH, KEYS_BEFORE, KEYS_AFTER]
  #
  # INDEX is the position in a list, or null for its end.
  alias Situ.EditLog.Listing

  @type path :: [String.t()]
  @type change :: [term()]

  @doc """
  Returns the changes that turn one document into another.

      iex> old = %{"tags" => ["a"], "sessions" => [%{"name" => "p1", "age" => 30}]}
      iex> new = %{"tags" => ["a", "b"], "sessions" => [%{"name" => "p1", "age" => 31}]}
      iex> changes = Situ.EditLog.Changes.diff(old, new)
      [["set", ["sessions", "p1", "age"], 30, 31], ["add", ["tags", "b"], "b", nil]]
      iex> Situ.EditLog.Changes.apply_all(old, changes)
      {:ok, new}
  """
  @spec diff(term(), term(), path()) :: [change()]
  def diff(before, later, path \\ [])
  def diff(same, same, _path), do: []

  def diff(%{} = before, %{} = later, path) do
    keys = before |> Map.merge(later) |> Map.keys() |> Enum.sort()
    Enum.flat_map(keys, &diff_member(before, later, &1, path ++ [&1]))
  end

  def diff(before, later, path) when is_list(before) and is_list(later) do
    if Listing.keyed?(before, later),
      do: Listing.diff(before, later, path, &diff/3),
      else: [["set", path, before, later]]
  end

  def diff(before, later, path), do: [["set", path, before, later]]

  defp diff_member(before, later, key, path) do
    case {before, later} do
      {%{^key => a}, %{^key => b}} -> diff(a, b, path)
      {%{^key => a}, _} -> [["remove", path, a, nil]]
      {_, %{^key => b}} -> [["add", path, b, nil]]
    end
  end

  @doc "Applies changes in order; returns the first conflicting change."
  @spec apply_all(term(), [change()]) :: {:ok, term()} | {:conflict, change()}
  def apply_all(document, changes) do
    Enum.reduce_while(changes, {:ok, document}, fn change, {:ok, document} ->
      case apply_change(document, change) do
        {:ok, document} -> {:cont, {:ok, document}}
        :conflict -> {:halt, {:conflict, change}}
      end
    end)
  end

  @doc """
  Applies a change. A change whose result is already there has no effect. Returns `:conflict` if the place has another
  content than the change expects.
  """
  @spec apply_change(term(), change()) :: {:ok, term()} | :conflict
  def apply_change(document, [kind, [], before, later]) when kind in ["set", "order"],
    do: edit_value(document, [kind, [], before, later])

  def apply_change(document, [kind, [key], a, b]) when kind in ["add", "remove"],
    do: edit_member(document, kind, key, {a, b})

  def apply_change(list, ["rename", [_], from, to]) when is_list(list),
    do: Listing.rename_item(list, from, {to, &put_name(&1, to)})

  def apply_change(document, [kind, [key | rest], a, b]) do
    case fetch_member(document, key) do
      {:ok, member} ->
        with {:ok, member} <- apply_change(member, [kind, rest, a, b]),
             do: {:ok, put_member(document, key, member)}

      :error ->
        :conflict
    end
  end

  def apply_change(_document, _change), do: :conflict

  defp put_name(%{} = item, name), do: Map.put(item, "name", name)
  defp put_name(_text, name), do: name

  defp edit_value(value, ["set", [], _before, value]), do: {:ok, value}
  defp edit_value(value, ["set", [], value, later]), do: {:ok, later}

  defp edit_value(list, ["order", [], _, _] = change) when is_list(list),
    do: Listing.apply_change(list, change)

  defp edit_value(_value, _change), do: :conflict

  defp edit_member(%{} = object, kind, key, {value, _index}) do
    case {kind, Map.fetch(object, key)} do
      {"add", :error} -> {:ok, Map.put(object, key, value)}
      {"add", {:ok, ^value}} -> {:ok, object}
      {"remove", {:ok, ^value}} -> {:ok, Map.delete(object, key)}
      {"remove", :error} -> {:ok, object}
      _ -> :conflict
    end
  end

  defp edit_member(list, kind, key, {value, index}) when is_list(list),
    do: Listing.apply_change(list, [kind, [key], value, index])

  defp edit_member(_, _, _, _), do: :conflict

  defp fetch_member(%{} = object, key), do: Map.fetch(object, key)
  defp fetch_member(list, key) when is_list(list), do: Listing.fetch_item(list, key)
  defp fetch_member(_, _), do: :error

  defp put_member(%{} = object, key, member), do: Map.put(object, key, member)
  defp put_member(list, key, member), do: Listing.replace_item(list, key, member)

  @doc """
  Returns the changes that undo changes.

      iex> Situ.EditLog.Changes.invert([["add", ["tags", "a"], "a", nil], ["set", ["name"], "x", "y"]])
      [["set", ["name"], "y", "x"], ["remove", ["tags", "a"], "a", nil]]
  """
  @spec invert([change()]) :: [change()]
  def invert(changes), do: changes |> Enum.reverse() |> Enum.map(&invert_change/1)

  defp invert_change(["add", path, value, index]), do: ["remove", path, value, index]
  defp invert_change(["remove", path, value, index]), do: ["add", path, value, index]

  defp invert_change(["rename", path, from, to]),
    do: ["rename", List.replace_at(path, -1, to), to, from]

  defp invert_change([kind, path, before, later]), do: [kind, path, later, before]

  @doc "Returns whether a term from a log is a change. Anybody with access to the folder may have written it."
  @spec change?(term()) :: boolean()
  def change?([kind, path, a, b]) when is_list(path),
    do: Enum.all?(path, &is_binary/1) and valid_change?(kind, path, {a, b})

  def change?(_), do: false

  # A document remains an object.
  defp valid_change?(_kind, [], _values), do: false
  defp valid_change?("set", _path, _values), do: true

  defp valid_change?(kind, _path, {_value, index}) when kind in ["add", "remove"],
    do: index == nil or (is_integer(index) and index >= 0)

  defp valid_change?("rename", _path, {from, to}), do: is_binary(from) and is_binary(to)

  defp valid_change?("order", _path, {before, later}),
    do: Enum.all?([before, later], &(is_list(&1) and Enum.all?(&1, fn key -> is_binary(key) end)))

  defp valid_change?(_kind, _path, _values), do: false

  @doc "Applies a change and overwrites other changes of its place; returns the document."
  @spec force_change(term(), change()) :: term()
  def force_change(document, change) do
    case apply_change(document, change) do
      {:ok, document} -> document
      :conflict -> overwrite_value(document, change)
    end
  end

  defp overwrite_value(document, [_, [], _, later]) when not is_nil(document), do: later

  defp overwrite_value(document, [kind, [key], a, b]) when kind in ["add", "remove"] do
    with {:ok, current} <- fetch_member(document, key),
         {:ok, bare} <- apply_change(document, ["remove", [key], current, nil]),
         {:ok, result} <-
           if(kind == "add", do: apply_change(bare, ["add", [key], a, b]), else: {:ok, bare}) do
      result
    else
      _ -> document
    end
  end

  defp overwrite_value(document, ["set", [key], _before, later]) when is_map(document),
    do: Map.put(document, key, later)

  defp overwrite_value(document, [kind, [key | rest], a, b]) do
    case fetch_member(document, key) do
      {:ok, member} -> put_member(document, key, force_change(member, [kind, rest, a, b]))
      :error -> document
    end
  end

  defp overwrite_value(document, _change), do: document
end
