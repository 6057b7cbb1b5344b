defmodule Situ.CLI.Store.Diff do
  @moduledoc false
  # Compares two recordings: streams that exist in only one, types, and messages in order of time.
  alias Situ.CLI.Store.ItemReader
  alias Situ.Store

  @doc "Returns the differences of each stream. `envelopes: true` also compares creation times and sequence numbers."
  @spec compare_stores(Store.t(), Store.t(), keyword()) :: [map()]
  def compare_stores(a, b, opts) do
    left = Map.new(Store.streams(a), &{&1.name, &1})
    right = Map.new(Store.streams(b), &{&1.name, &1})

    for name <- Enum.uniq(Map.keys(left) ++ Map.keys(right)) |> Enum.sort() do
      compare_stream(name, {a, left[name]}, {b, right[name]}, opts)
    end
  end

  defp compare_stream(name, {_, nil}, {_, info}, _opts), do: only_in_one(name, :second, info)
  defp compare_stream(name, {_, info}, {_, nil}, _opts), do: only_in_one(name, :first, info)

  defp compare_stream(name, {a, left}, {b, right}, opts) do
    tapes = {open_tape(a, left), open_tape(b, right)}
    start = %{equal: 0, different: 0, only_first: 0, only_second: 0, at: nil}
    counted = compare_tapes(tapes, start, opts)
    types = if left.type_name != right.type_name, do: [left.type_name, right.type_name]

    counted
    |> Map.merge(%{stream: name, only: nil, types: types})
    |> Map.put(:same, counted.at == nil and types == nil)
  end

  defp only_in_one(name, where, info),
    do: %{stream: name, only: where, messages: info.count, same: false}

  defp open_tape(store, info),
    do: store |> Store.messages(info) |> ItemReader.open() |> ItemReader.next_item()

  defp compare_tapes({nil, nil}, counted, _opts), do: counted

  defp compare_tapes({{m, rest}, nil}, c, opts),
    do:
      compare_tapes({ItemReader.next_item(rest), nil}, count_difference(c, :only_first, m), opts)

  defp compare_tapes({nil, {m, rest}}, c, opts),
    do:
      compare_tapes({nil, ItemReader.next_item(rest)}, count_difference(c, :only_second, m), opts)

  defp compare_tapes({{a, left}, {b, right}} = tapes, counted, opts) do
    cond do
      a.originating_time < b.originating_time ->
        compare_tapes(
          {ItemReader.next_item(left), elem(tapes, 1)},
          count_difference(counted, :only_first, a),
          opts
        )

      a.originating_time > b.originating_time ->
        compare_tapes(
          {elem(tapes, 0), ItemReader.next_item(right)},
          count_difference(counted, :only_second, b),
          opts
        )

      same_message?(a, b, opts) ->
        compare_tapes(
          {ItemReader.next_item(left), ItemReader.next_item(right)},
          %{counted | equal: counted.equal + 1},
          opts
        )

      true ->
        compare_tapes(
          {ItemReader.next_item(left), ItemReader.next_item(right)},
          count_difference(counted, :different, a),
          opts
        )
    end
  end

  defp count_difference(counted, key, message) do
    counted |> Map.update!(key, &(&1 + 1)) |> Map.update!(:at, &(&1 || message.originating_time))
  end

  defp same_message?(a, b, opts) do
    a.data === b.data and
      (not opts[:envelopes] or
         {a.creation_time, a.sequence_id} == {b.creation_time, b.sequence_id})
  end
end
