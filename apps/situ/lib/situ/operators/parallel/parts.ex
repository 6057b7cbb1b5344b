defmodule Situ.Parallel.Parts do
  @moduledoc false
  # Splits a message into a list or map of parts, and checks it against the form of the parallel operator.

  @type form :: {:fixed, pos_integer()} | :variable | :sparse | :present

  @doc "Returns the parts of a message's data, split by `split` if it is given."
  @spec of(form(), (term() -> term()) | nil, term()) :: list() | map()
  def of(form, split, data) when is_function(split, 1), do: checked(form, split.(data))
  def of(form, _split, data), do: checked(form, data)

  @doc "Returns the key and value of each part. The keys of a list are its positions."
  @spec pairs(list() | map()) :: [{term(), term()}]
  def pairs(list) when is_list(list), do: number(list, 0)

  # Sorted by key, because the order of a map differs between Erlang versions, and branches are started in this order.
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
            "expected #{wanted} of parts, got: #{inspect(other, limit: 5)}",
            fix: "set split: fn data -> #{wanted} end"
          )
  end

  defp wrong_length(n, got) do
    Situ.Error.new(:wrong_length, "expected a list of #{n} elements, got #{got} elements",
      why: "size: fixes the number of branches",
      fix: "omit size: if the length varies"
    )
  end
end
