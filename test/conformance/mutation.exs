defmodule Situ.Conformance.Mutation do
  # Verifies the checks themselves: changes the parts of a case's expectation one at a time, and
  # each change must make the case fail. A case that still passes checks less than it claims.

  # Cases that take longer than this are tried with a few changes only.
  @slow_us 100_000

  # Returns `[{id, how}]`: undetected changes of passing cases of a file. At most `most` changes
  # are tried per case, spread over it.
  def survivors(file, most) do
    for {case, verdict, us} <- Situ.Conformance.timed_verdicts(file),
        verdict == :pass,
        {how, mutant} <-
          case |> mutants() |> spread(if(us > @slow_us, do: min(most, 3), else: most)),
        Situ.Conformance.verdict(Situ.Conformance.area(file), mutant) == :pass,
        do: {case["id"], how}
  end

  defp spread(mutants, most) do
    every = max(1, ceil(length(mutants) / most))
    Enum.take_every(mutants, every)
  end

  # Returns `{how, case}` for each part of its expectation.
  def mutants(case) do
    for {kind, expected} <- Map.take(case, ["expect", "expect_error"]),
        {path, changed} <- changes(expected, []),
        do: {"#{kind}#{path(path)}", Map.put(case, kind, changed)}
  end

  defp path(path), do: path |> Enum.reverse() |> Enum.map_join(&"[#{inspect(&1)}]")

  # Changes each leaf separately, and adds an entry to each list. The action, value and times of a
  # script's step are input and stay unchanged.
  defp changes(%{"do" => _} = step, path) do
    for {key, value} <- Map.drop(step, ~w(do v t_ms now_ms)),
        {at, changed} <- changes(value, [key | path]),
        do: {at, Map.put(step, key, changed)}
  end

  defp changes(list, path) when is_list(list) do
    inner =
      for {item, i} <- Enum.with_index(list),
          {at, changed} <- changes(item, [i | path]),
          do: {at, List.replace_at(list, i, changed)}

    [{["one more" | path], list ++ ["more"]} | inner]
  end

  defp changes(map, path) when is_map(map) do
    for {key, value} <- map,
        {at, changed} <- changes(value, [key | path]),
        do: {at, Map.put(map, key, changed)}
  end

  defp changes(value, [key | _] = path) when is_binary(key) and is_number(value) do
    # A limit is violated by a narrower one.
    cond do
      key =~ ~r/within|less_than|at_most|at_or_after/ -> [{path, -1}]
      key =~ ~r/at_least|min_/ -> [{path, 1_000 * (abs(value) + 1)}]
      true -> [{path, other(value)}]
    end
  end

  defp changes(value, path), do: [{path, other(value)}]

  defp other(nil), do: 123_456
  defp other(boolean) when is_boolean(boolean), do: not boolean
  defp other(number) when is_integer(number), do: number + 1

  defp other(number) when is_float(number),
    do: if(abs(number) < 1.0e300, do: number + abs(number) + 1.0, else: -number)

  defp other(text) when is_binary(text), do: text <> "_changed"
end
