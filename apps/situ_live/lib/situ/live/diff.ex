defmodule Situ.Live.Diff do
  @moduledoc """
  Computes the difference between the tree that a browser shows and a newly rendered one, as the message that the
  LiveView client merges.

  The module is pure: `run/2` takes the tree and the memory of the last one, and returns the message and the new memory.
  Only values that differ are sent. List entries that moved are sent as moves, and the static strings of a template
  are sent once.

  The memory holds the values last sent: `{:tree, fingerprint, values}`, `{:list, fingerprint, %{key => {index,
  values}}}`, `{:stream, fingerprint}`, `{:island, cid, memory}` or a string.
  """
  alias Situ.Live.{Comprehension, Island, Rendered}

  defstruct root: nil, next_cid: 1

  @type t :: %__MODULE__{}

  @doc """
  Returns the diff (`%{}` if nothing changed) and the new memory.

  Returns `:stale` if the tree omits values as unchanged that the browser does not have because it showed another
  template. The caller must then render again with everything treated as changed.
  """
  @spec run(Rendered.t(), t()) :: {map(), t()} | :stale
  def run(%Rendered{} = rendered, %__MODULE__{} = memory \\ %__MODULE__{}) do
    diff(rendered, memory)
  catch
    :stale -> :stale
  end

  defp diff(rendered, memory) do
    acc = %{statics: %{}, islands: %{}, next_cid: memory.next_cid}
    {diff, root, acc} = root(rendered, memory.root, acc)
    diff = if acc.islands == %{}, do: diff, else: Map.put(diff, "c", acc.islands)
    {diff, %{memory | root: root, next_cid: acc.next_cid}}
  end

  @doc "Returns the given island numbers whose islands are shown."
  @spec present(t(), [integer()]) :: [integer()]
  def present(%__MODULE__{root: root}, cids) do
    shown = root |> cids([]) |> MapSet.new()
    Enum.filter(cids, &(&1 in shown))
  end

  defp cids({:island, cid, memory}, acc), do: cids(memory, [cid | acc])
  defp cids({:tree, _, values}, acc), do: Enum.reduce(values, acc, &cids/2)

  defp cids({:list, _, entries}, acc) do
    Enum.reduce(entries, acc, fn {_, {_, values}}, acc -> Enum.reduce(values, acc, &cids/2) end)
  end

  defp cids(_, acc), do: acc

  # A tree with its own table of static strings: the page, or one island.
  defp root(rendered, memory, acc) do
    outer = acc.statics
    {diff, memory, acc} = value(rendered, memory, %{acc | statics: %{}}, :own)
    diff = if diff == :same, do: %{}, else: diff

    diff =
      if acc.statics == %{},
        do: diff,
        else: Map.put(diff, "p", Map.new(acc.statics, fn {_, {i, s}} -> {index(i), s} end))

    {diff, memory, %{acc | statics: outer}}
  end

  # -- value: {diff | :same, memory, acc}

  defp value(:unchanged, memory, acc, _), do: {:same, memory, acc}
  defp value(text, text, acc, _) when is_binary(text), do: {:same, text, acc}
  defp value(text, _, acc, _) when is_binary(text), do: {text, text, acc}

  defp value(%Rendered{fingerprint: fp, dynamic: dynamic}, {:tree, fp, old}, acc, _) do
    {diff, values, acc} = known(dynamic, old, acc)
    {if(diff == %{}, do: :same, else: diff), {:tree, fp, values}, acc}
  end

  defp value(%Rendered{fingerprint: fp} = rendered, _, acc, where) do
    {diff, values, acc} = new(rendered.dynamic, acc)
    {static, acc} = static(rendered.static, fp, acc, where)
    {Map.put(diff, "s", static), {:tree, fp, values}, acc}
  end

  # A stream without inserts or deletes.
  defp value(%Comprehension{stream: [_, [], []], fingerprint: fp}, {:stream, fp}, acc, _),
    do: {:same, {:stream, fp}, acc}

  defp value(%Comprehension{stream: [_ | _] = stream} = list, memory, acc, _) do
    fp = list.fingerprint
    {diff, _, acc} = entries(list, %{}, acc, memory != {:stream, fp})
    diff = if diff == :same, do: %{"k" => %{"kc" => 0}}, else: diff
    {Map.put(diff, "stream", stream), {:stream, fp}, acc}
  end

  defp value(%Comprehension{fingerprint: fp} = list, {:list, fp, old}, acc, _),
    do: entries(list, old, acc, false)

  defp value(%Comprehension{} = list, _, acc, _), do: entries(list, %{}, acc, true)

  defp value(%Island{rendered: rendered}, {:island, cid, old}, acc, _) do
    {diff, memory, acc} = root(rendered, old, acc)
    {:same, {:island, cid, memory}, island(acc, cid, diff)}
  end

  # Island numbers are never reused within one join.
  defp value(%Island{rendered: rendered}, _, acc, _) do
    cid = acc.next_cid
    {diff, memory, acc} = root(rendered, nil, %{acc | next_cid: cid + 1})
    {cid, {:island, cid, memory}, island(acc, cid, diff)}
  end

  defp island(acc, _cid, diff) when diff == %{}, do: acc

  # When the static strings are new, the client needs the flag for a single root tag again.
  defp island(acc, cid, diff) do
    diff = if is_map_key(diff, "s"), do: Map.put(diff, "r", 1), else: diff
    %{acc | islands: Map.put(acc.islands, index(cid), diff)}
  end

  defp known(dynamic, old, acc), do: known(dynamic, old, acc, 0, %{}, [])

  defp known([], [], acc, _, diff, values), do: {diff, Enum.reverse(values), acc}

  defp known([value | rest], [old | olds], acc, i, diff, values) do
    case value(value, old, acc, :shared) do
      {:same, memory, acc} ->
        known(rest, olds, acc, i + 1, diff, [memory | values])

      {changed, memory, acc} ->
        diff = Map.put(diff, index(i), changed)
        known(rest, olds, acc, i + 1, diff, [memory | values])
    end
  end

  defp new(dynamic, acc), do: new(dynamic, acc, 0, %{}, [])

  defp new([], acc, _, diff, values), do: {diff, Enum.reverse(values), acc}

  defp new([:unchanged | _], _, _, _, _), do: throw(:stale)

  defp new([value | rest], acc, i, diff, values) do
    {made, memory, acc} = value(value, nil, acc, :shared)
    new(rest, acc, i + 1, Map.put(diff, index(i), made), [memory | values])
  end

  # -- lists

  defp entries(list, old, acc, new?) do
    start = %{diff: %{}, memory: %{}, count: 0, moved?: false, acc: acc}
    found = Enum.reduce(list.entries, start, &entry(&1, old, &2))
    memory = {:list, list.fingerprint, found.memory}

    if not new? and found.diff == %{} and found.count == map_size(old) do
      {:same, memory, found.acc}
    else
      keyed = Map.put(found.diff, "kc", found.count)
      keyed = if found.moved?, do: Map.put(keyed, "km", true), else: keyed
      list_diff(list, %{"k" => keyed}, memory, found.acc, new?)
    end
  end

  defp list_diff(_list, diff, memory, acc, false), do: {diff, memory, acc}

  defp list_diff(list, diff, memory, acc, true) do
    {static, acc} = static(list.static, list.fingerprint, acc, :shared)
    {Map.put(diff, "s", static), memory, acc}
  end

  # If two entries share a key, the second is identified by its index, like entries without a key.
  defp entry({key, dynamic}, old, found) do
    i = found.count
    key = if key == nil, do: {:index, i}, else: {:key, key}
    key = if is_map_key(found.memory, key), do: {:index, i}, else: key

    {diff, values, acc, moved?} =
      case old do
        %{^key => {from, values}} -> moved(dynamic, values, from, i, found)
        _ -> fresh(dynamic, i, found)
      end

    memory = Map.put(found.memory, key, {i, values})
    %{diff: diff, memory: memory, count: i + 1, moved?: found.moved? or moved?, acc: acc}
  end

  defp fresh(dynamic, i, found) do
    {made, values, acc} = new(dynamic, found.acc)
    {Map.put(found.diff, index(i), made), values, acc, false}
  end

  defp moved(dynamic, old, from, i, found) do
    {changed, values, acc} = known(dynamic, old, found.acc)

    diff =
      cond do
        changed == %{} and from == i -> found.diff
        changed == %{} -> Map.put(found.diff, index(i), from)
        from == i -> Map.put(found.diff, index(i), changed)
        true -> Map.put(found.diff, index(i), [from, changed])
      end

    {diff, values, acc, from != i}
  end

  # -- static strings

  defp static(static, _fp, acc, :own), do: {static, acc}

  defp static(static, fp, acc, :shared) do
    case acc.statics do
      %{^fp => {i, _}} ->
        {i, acc}

      statics ->
        i = map_size(statics)
        {i, %{acc | statics: Map.put(statics, fp, {i, static})}}
    end
  end

  # JSON keys are strings; the common ones are precomputed.
  for i <- 0..63, do: defp(index(unquote(i)), do: unquote(Integer.to_string(i)))
  defp index(i), do: Integer.to_string(i)
end
