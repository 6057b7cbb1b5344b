defmodule Situ.Infer.Speech.Jsgf.Matcher do
  @moduledoc false
  # Matches the words of a sentence against a grammar. For each position, it computes the positions where an expansion
  # can end, with the tags up to there. If several derivations reach the same position, the first one counts. Each
  # rule is tried once per position, so the work is bounded by the size of the grammar times the square of the number
  # of words.
  alias Situ.Infer.Speech.{Jsgf, Number}

  @type tag :: {text :: String.t(), value :: String.t()}

  @doc "Returns the ends of a rule that starts at `from`, farthest first, as `{end, tags}`."
  @spec find_ends(Jsgf.t(), String.t(), tuple(), non_neg_integer()) :: [
          {non_neg_integer(), [tag()]}
        ]
  def find_ends(%Jsgf{rules: rules}, rule, words, from) do
    {ends, _} = expansion_ends({:rule, rule}, from, %{rules: rules, words: words, memo: %{}})

    ends
    |> Enum.map(fn {at, tags} -> {at, Enum.reverse(tags)} end)
    |> Enum.sort_by(&(-elem(&1, 0)))
  end

  # Tags are collected in reverse order.
  defp expansion_ends({:word, word}, at, state) do
    if at < tuple_size(state.words) and elem(state.words, at) == word,
      do: {[{at + 1, []}], state},
      else: {[], state}
  end

  defp expansion_ends({:rule, "NULL"}, at, state), do: {[{at, []}], state}
  defp expansion_ends({:rule, "VOID"}, _at, state), do: {[], state}

  defp expansion_ends({:rule, "WORDS"}, at, state),
    do: {for(to <- tuple_size(state.words)..(at + 1)//-1, do: {to, []}), state}

  defp expansion_ends({:rule, "NUMBER"}, at, state) do
    words = state.words |> Tuple.to_list() |> Enum.drop(at)
    {for({n, _value} <- Number.parse_prefixes(words), do: {at + n, []}), state}
  end

  defp expansion_ends({:rule, name}, at, state) do
    case state.memo do
      # A rule that is requested again while it is being computed is recursive; an empty result ends the recursion.
      %{{^name, ^at} => ends} ->
        {ends, state}

      _ ->
        state = put_in(state.memo[{name, at}], [])
        {ends, state} = expansion_ends(Map.fetch!(state.rules, name), at, state)
        {ends, put_in(state.memo[{name, at}], ends)}
    end
  end

  defp expansion_ends({:alt, parts}, at, state) do
    {ends, state} = Enum.map_reduce(parts, state, &expansion_ends(&1, at, &2))
    {ends |> Enum.concat() |> first_per_end(), state}
  end

  defp expansion_ends({:seq, parts}, at, state) do
    Enum.reduce(parts, {[{at, []}], state}, fn part, {ends, state} ->
      ends_after_each(part, ends, state)
    end)
  end

  defp expansion_ends({:optional, part}, at, state) do
    {ends, state} = expansion_ends(part, at, state)
    {first_per_end(ends ++ [{at, []}]), state}
  end

  defp expansion_ends({:some, part}, at, state) do
    {ends, state} = expansion_ends(part, at, state)
    repeat_ends(part, ends, ends, state)
  end

  defp expansion_ends({:many, part}, at, state),
    do: repeat_ends(part, [{at, []}], [{at, []}], state)

  defp expansion_ends({:tag, part, text}, at, state) do
    {ends, state} = expansion_ends(part, at, state)

    {for({to, tags} <- ends, do: {to, [{text, tag_value(part, state.words, at, to)} | tags]}),
     state}
  end

  defp ends_after_each(part, ends, state) do
    {more, state} =
      Enum.map_reduce(ends, state, fn {at, tags}, state ->
        {ends, state} = expansion_ends(part, at, state)
        {for({to, new} <- ends, do: {to, new ++ tags}), state}
      end)

    {more |> Enum.concat() |> first_per_end(), state}
  end

  # Repeats from each new end until no new ends are found.
  defp repeat_ends(_part, all, [], state), do: {all, state}

  defp repeat_ends(part, all, new, state) do
    {more, state} = ends_after_each(part, new, state)
    more = Enum.reject(more, fn {to, _} -> List.keymember?(all, to, 0) end)
    repeat_ends(part, all ++ more, more, state)
  end

  defp first_per_end(ends), do: Enum.uniq_by(ends, &elem(&1, 0))

  defp tag_value({:rule, "NUMBER"}, words, at, to) do
    part = words |> Tuple.to_list() |> Enum.slice(at, to - at)
    {_, n} = List.keyfind(Number.parse_prefixes(part), to - at, 0)
    Integer.to_string(n)
  end

  defp tag_value(_part, words, at, to),
    do: words |> Tuple.to_list() |> Enum.slice(at, to - at) |> Enum.join(" ")
end
