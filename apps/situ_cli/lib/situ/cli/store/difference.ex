defmodule Situ.CLI.Store.Difference do
  @moduledoc false
  # Compares two recordings: streams that exist in only one, types, and messages in order of time.
  alias Situ.CLI.Store.Tape
  alias Situ.Store

  @doc "Returns the differences of each stream. `envelopes: true` also compares creation times and sequence numbers."
  @spec of(Store.Handle.t(), Store.Handle.t(), keyword()) :: [map()]
  def of(a, b, opts) do
    left = Map.new(Store.streams(a), &{&1.name, &1})
    right = Map.new(Store.streams(b), &{&1.name, &1})

    for name <- Enum.uniq(Map.keys(left) ++ Map.keys(right)) |> Enum.sort() do
      stream(name, {a, left[name]}, {b, right[name]}, opts)
    end
  end

  defp stream(name, {_, nil}, {_, info}, _opts), do: alone(name, :second, info)
  defp stream(name, {_, info}, {_, nil}, _opts), do: alone(name, :first, info)

  defp stream(name, {a, left}, {b, right}, opts) do
    tapes = {tape(a, left), tape(b, right)}
    start = %{equal: 0, different: 0, only_first: 0, only_second: 0, at: nil}
    counted = walk(tapes, start, opts)
    types = if left.type_name != right.type_name, do: [left.type_name, right.type_name]

    counted
    |> Map.merge(%{stream: name, only: nil, types: types})
    |> Map.put(:same, counted.at == nil and types == nil)
  end

  defp alone(name, where, info),
    do: %{stream: name, only: where, messages: info.count, same: false}

  defp tape(store, info), do: store |> Store.messages(info) |> Tape.open() |> Tape.next()

  defp walk({nil, nil}, counted, _opts), do: counted

  defp walk({{m, rest}, nil}, c, opts),
    do: walk({Tape.next(rest), nil}, note(c, :only_first, m), opts)

  defp walk({nil, {m, rest}}, c, opts),
    do: walk({nil, Tape.next(rest)}, note(c, :only_second, m), opts)

  defp walk({{a, left}, {b, right}} = tapes, counted, opts) do
    cond do
      a.originating_time < b.originating_time ->
        walk({Tape.next(left), elem(tapes, 1)}, note(counted, :only_first, a), opts)

      a.originating_time > b.originating_time ->
        walk({elem(tapes, 0), Tape.next(right)}, note(counted, :only_second, b), opts)

      same?(a, b, opts) ->
        walk({Tape.next(left), Tape.next(right)}, %{counted | equal: counted.equal + 1}, opts)

      true ->
        walk({Tape.next(left), Tape.next(right)}, note(counted, :different, a), opts)
    end
  end

  defp note(counted, key, message) do
    counted |> Map.update!(key, &(&1 + 1)) |> Map.update!(:at, &(&1 || message.originating_time))
  end

  defp same?(a, b, opts) do
    a.data === b.data and
      (not opts[:envelopes] or
         {a.creation_time, a.sequence_id} == {b.creation_time, b.sequence_id})
  end
end
