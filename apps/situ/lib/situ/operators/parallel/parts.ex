defmodule Situ.Parallel.Parts do
  @moduledoc false
  # The list or map of parts that a message is split into, checked against the form of a parallel operator.

  @type form :: {:fixed, pos_integer()} | :variable | :sparse | :present

  @doc "The parts of a message's data, by `split` if there is one."
  @spec of(form(), (term() -> term()) | nil, term()) :: list() | map()
  def of(form, split, data) when is_function(split, 1), do: checked(form, split.(data))
  def of(form, _split, data), do: checked(form, data)

  @doc "Key and value of each; the keys of a list are its positions."
  @spec pairs(list() | map()) :: [{term(), term()}]
  def pairs(list) when is_list(list), do: number(list, 0)

  # By key: the order of a map's own is not the same in every Erlang, and branches begin in this one.
  def pairs(map), do: map |> Map.to_list() |> List.keysort(0)

  defp number([], _i), do: []
  defp number([value | rest], i), do: [{i, value} | number(rest, i + 1)]

  defp checked({:fixed, n}, list) when is_list(list) do
    if length(list) == n, do: list, else: raise(wrong_length(n, length(list)))
  end

  defp checked(:variable, list) when is_list(list), do: list
  defp checked(form, map) when is_map(map) and form in [:sparse, :present], do: map

  defp checked(form, other) do
    wanted = if form in [:sparse, :present], do: "a map", else: "a list"

    raise Situ.Error.new(
            :wrong_data,
            "parallel takes #{wanted} here, got: #{inspect(other, limit: 5)}",
            fix: "give split: fn data -> #{wanted} end"
          )
  end

  defp wrong_length(n, got) do
    Situ.Error.new(:wrong_length, "a list of #{got} elements for #{n} branches",
      why: "size: fixes the number of branches",
      fix: "leave size: out where the length varies"
    )
  end
end
