defmodule Situ.Parallel.Parts do
  @moduledoc false
  # Splits a message into a list or map of parts, and checks it against the form of the parallel operator.

  @type form :: {:fixed, pos_integer()} | :variable | :sparse | :present

  @doc "Returns the parts of a message's data, split by `split` if it is given."
  @spec split_parts(form(), (term() -> term()) | nil, term()) :: list() | map()
  def split_parts(form, split, data) when is_function(split, 1),
    do: check_parts(form, split.(data))

  def split_parts(form, _split, data), do: check_parts(form, data)

  @doc "Returns the key and value of each part. The keys of a list are its positions."
  @spec to_pairs(list() | map()) :: [{term(), term()}]
  def to_pairs(list) when is_list(list), do: number_parts(list, 0)

  # Sorted by key, because the order of a map differs between Erlang versions, and branches are started in this order.
  def to_pairs(map), do: map |> Map.to_list() |> List.keysort(0)

  defp number_parts([], _i), do: []
  defp number_parts([value | rest], i), do: [{i, value} | number_parts(rest, i + 1)]

  defp check_parts({:fixed, n}, list) when is_list(list) do
    if length(list) == n, do: list, else: raise(wrong_length_error(n, length(list)))
  end

  defp check_parts(:variable, list) when is_list(list), do: list
  defp check_parts(form, map) when is_map(map) and form in [:sparse, :present], do: map

  defp check_parts(form, other) do
    expected = if form in [:sparse, :present], do: "a map", else: "a list"

    raise Situ.Error.new(
            :wrong_data,
            "expected #{expected} of parts, got: #{inspect(other, limit: 5)}",
            fix: "set split: fn data -> #{expected} end"
          )
  end

  defp wrong_length_error(n, got) do
    Situ.Error.new(:wrong_length, "expected a list of #{n} elements, got #{got} elements",
      why: "size: fixes the number of branches",
      fix: "omit size: if the length varies"
    )
  end
end
