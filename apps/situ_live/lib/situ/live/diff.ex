defmodule Situ.Live.Diff do
  @moduledoc false
  # Computes the difference between the tree that a browser shows and a newly rendered one, as the
  # message that the LiveView client merges.
  #
  # The module is pure: `diff_tree/2` takes the tree and the memory of the last one, and returns
  # the message and the new memory. Only values that differ are sent. List entries that moved are
  # sent as moves, and the static strings of a template are sent once.
  #
  # The memory holds the values last sent: `{:tree, fingerprint, values}`, `{:list, fingerprint,
  # %{key => {index, values}}}`, `{:stream, fingerprint}`, `{:island, cid, memory}` or a string.
  # See docs/adr/0071-templates-are-compiled-here-and-diffed-by-value.md.
  alias Situ.Live.{Comprehension, Island, Rendered}

  defstruct root: nil, next_cid: 1

  @type t :: %__MODULE__{}

  @doc """
  Returns the diff (`%{}` if nothing changed) and the new memory.

  Returns `:stale` if the tree omits values as unchanged that the browser does not have because it showed another
  template. The caller must then render again with everything treated as changed.
  """
  @spec diff_tree(Rendered.t(), t()) :: {map(), t()} | :stale
  def diff_tree(%Rendered{} = rendered, %__MODULE__{} = memory \\ %__MODULE__{}) do
    diff_page(rendered, memory)
  catch
    :stale -> :stale
  end

  defp diff_page(rendered, memory) do
    acc = %{statics: %{}, islands: %{}, next_cid: memory.next_cid}
    {diff, root, acc} = diff_root(rendered, memory.root, acc)
    diff = if acc.islands == %{}, do: diff, else: Map.put(diff, "c", acc.islands)
    {diff, %{memory | root: root, next_cid: acc.next_cid}}
  end

  @doc "Returns the given island numbers whose islands are shown."
  @spec visible_cids(t(), [integer()]) :: [integer()]
  def visible_cids(%__MODULE__{root: root}, cids) do
    visible = root |> collect_cids([]) |> MapSet.new()
    Enum.filter(cids, &(&1 in visible))
  end

  defp collect_cids({:island, cid, memory}, acc), do: collect_cids(memory, [cid | acc])
  defp collect_cids({:tree, _, values}, acc), do: Enum.reduce(values, acc, &collect_cids/2)

  defp collect_cids({:list, _, entries}, acc) do
    Enum.reduce(entries, acc, fn {_, {_, values}}, acc ->
      Enum.reduce(values, acc, &collect_cids/2)
    end)
  end

  defp collect_cids(_, acc), do: acc

  # A tree with its own table of static strings: the page, or one island.
  defp diff_root(rendered, memory, acc) do
    outer_statics = acc.statics
    {diff, memory, acc} = diff_value(rendered, memory, %{acc | statics: %{}}, :own)
    diff = if diff == :same, do: %{}, else: diff

    diff =
      if acc.statics == %{},
        do: diff,
        else: Map.put(diff, "p", Map.new(acc.statics, fn {_, {i, s}} -> {json_index(i), s} end))

    {diff, memory, %{acc | statics: outer_statics}}
  end

  # -- value: {diff | :same, memory, acc}

  defp diff_value(:unchanged, memory, acc, _), do: {:same, memory, acc}
  defp diff_value(text, text, acc, _) when is_binary(text), do: {:same, text, acc}
  defp diff_value(text, _, acc, _) when is_binary(text), do: {text, text, acc}

  defp diff_value(%Rendered{fingerprint: fp, dynamic: dynamic}, {:tree, fp, old}, acc, _) do
    {diff, values, acc} = diff_values(dynamic, old, acc)
    {if(diff == %{}, do: :same, else: diff), {:tree, fp, values}, acc}
  end

  defp diff_value(%Rendered{fingerprint: fp} = rendered, _, acc, table) do
    {diff, values, acc} = build_values(rendered.dynamic, acc)
    {static, acc} = put_static(rendered.static, fp, acc, table)
    {Map.put(diff, "s", static), {:tree, fp, values}, acc}
  end

  # A stream without inserts or deletes.
  defp diff_value(%Comprehension{stream: [_, [], []], fingerprint: fp}, {:stream, fp}, acc, _),
    do: {:same, {:stream, fp}, acc}

  defp diff_value(%Comprehension{stream: [_ | _] = stream} = list, memory, acc, _) do
    fp = list.fingerprint
    {diff, _, acc} = diff_entries(list, %{}, acc, memory != {:stream, fp})
    diff = if diff == :same, do: %{"k" => %{"kc" => 0}}, else: diff
    {Map.put(diff, "stream", stream), {:stream, fp}, acc}
  end

  defp diff_value(%Comprehension{fingerprint: fp} = list, {:list, fp, old}, acc, _),
    do: diff_entries(list, old, acc, false)

  defp diff_value(%Comprehension{} = list, _, acc, _), do: diff_entries(list, %{}, acc, true)

  defp diff_value(%Island{rendered: rendered}, {:island, cid, old}, acc, _) do
    {diff, memory, acc} = diff_root(rendered, old, acc)
    {:same, {:island, cid, memory}, put_island_diff(acc, cid, diff)}
  end

  # Island numbers are never reused within one join.
  defp diff_value(%Island{rendered: rendered}, _, acc, _) do
    cid = acc.next_cid
    {diff, memory, acc} = diff_root(rendered, nil, %{acc | next_cid: cid + 1})
    {cid, {:island, cid, memory}, put_island_diff(acc, cid, diff)}
  end

  defp put_island_diff(acc, _cid, diff) when diff == %{}, do: acc

  # When the static strings are new, the client needs the flag for a single root tag again.
  defp put_island_diff(acc, cid, diff) do
    diff = if is_map_key(diff, "s"), do: Map.put(diff, "r", 1), else: diff
    %{acc | islands: Map.put(acc.islands, json_index(cid), diff)}
  end

  defp diff_values(dynamic, old, acc), do: diff_each_value(dynamic, old, acc, 0, %{}, [])

  defp diff_each_value([], [], acc, _, diff, values), do: {diff, Enum.reverse(values), acc}

  defp diff_each_value([value | rest], [old | olds], acc, i, diff, values) do
    case diff_value(value, old, acc, :shared) do
      {:same, memory, acc} ->
        diff_each_value(rest, olds, acc, i + 1, diff, [memory | values])

      {changed, memory, acc} ->
        diff = Map.put(diff, json_index(i), changed)
        diff_each_value(rest, olds, acc, i + 1, diff, [memory | values])
    end
  end

  defp build_values(dynamic, acc), do: build_each_value(dynamic, acc, 0, %{}, [])

  defp build_each_value([], acc, _, diff, values), do: {diff, Enum.reverse(values), acc}

  defp build_each_value([:unchanged | _], _, _, _, _), do: throw(:stale)

  defp build_each_value([value | rest], acc, i, diff, values) do
    {value_diff, memory, acc} = diff_value(value, nil, acc, :shared)

    build_each_value(rest, acc, i + 1, Map.put(diff, json_index(i), value_diff), [memory | values])
  end

  # -- lists

  defp diff_entries(list, old, acc, new?) do
    initial = %{diff: %{}, memory: %{}, count: 0, moved?: false, acc: acc}
    result = Enum.reduce(list.entries, initial, &diff_entry(&1, old, &2))
    memory = {:list, list.fingerprint, result.memory}

    if not new? and result.diff == %{} and result.count == map_size(old) do
      {:same, memory, result.acc}
    else
      keyed = Map.put(result.diff, "kc", result.count)
      keyed = if result.moved?, do: Map.put(keyed, "km", true), else: keyed
      put_list_static(list, %{"k" => keyed}, memory, result.acc, new?)
    end
  end

  defp put_list_static(_list, diff, memory, acc, false), do: {diff, memory, acc}

  defp put_list_static(list, diff, memory, acc, true) do
    {static, acc} = put_static(list.static, list.fingerprint, acc, :shared)
    {Map.put(diff, "s", static), memory, acc}
  end

  # If two entries share a key, the second is identified by its index, like entries without a key.
  defp diff_entry({key, dynamic}, old, result) do
    i = result.count
    key = if key == nil, do: {:index, i}, else: {:key, key}
    key = if is_map_key(result.memory, key), do: {:index, i}, else: key

    {diff, values, acc, moved?} =
      case old do
        %{^key => {from, values}} -> update_entry(dynamic, values, from, i, result)
        _ -> add_entry(dynamic, i, result)
      end

    memory = Map.put(result.memory, key, {i, values})
    %{diff: diff, memory: memory, count: i + 1, moved?: result.moved? or moved?, acc: acc}
  end

  defp add_entry(dynamic, i, result) do
    {value_diff, values, acc} = build_values(dynamic, result.acc)
    {Map.put(result.diff, json_index(i), value_diff), values, acc, false}
  end

  defp update_entry(dynamic, old, from, i, result) do
    {changed, values, acc} = diff_values(dynamic, old, result.acc)

    diff =
      cond do
        changed == %{} and from == i -> result.diff
        changed == %{} -> Map.put(result.diff, json_index(i), from)
        from == i -> Map.put(result.diff, json_index(i), changed)
        true -> Map.put(result.diff, json_index(i), [from, changed])
      end

    {diff, values, acc, from != i}
  end

  # -- static strings

  defp put_static(static, _fp, acc, :own), do: {static, acc}

  defp put_static(static, fp, acc, :shared) do
    case acc.statics do
      %{^fp => {i, _}} ->
        {i, acc}

      statics ->
        i = map_size(statics)
        {i, %{acc | statics: Map.put(statics, fp, {i, static})}}
    end
  end

  # JSON keys are strings; the common ones are precomputed.
  for i <- 0..63, do: defp(json_index(unquote(i)), do: unquote(Integer.to_string(i)))
  defp json_index(i), do: Integer.to_string(i)
end
