defmodule Situ.Bridge.Test.Expected do
  @moduledoc """
  Compares what Situ reads from each genuine \\psi store with the `expected.json` next to it.
  `test/data/psi/README.md` describes the form of that file.
  """
  import ExUnit.Assertions

  @epoch 621_355_968_000_000_000

  @doc "Converts ticks since the year 1 to nanoseconds since 1970."
  def ns(ticks), do: (ticks - @epoch) * 100

  @doc "Asserts that `got` equals the value read by \\psi's own reader."
  def same!(want, got, context) do
    Process.put(:ids, named(want, got, %{}))

    unless same?(want, got),
      do: flunk("#{context}\nexpected #{inspect(want)}\ngot      #{inspect(got)}")
  end

  defp same?(%{"$written" => want}, got), do: same?(want, got)
  defp same?(%{"$ref" => n}, got), do: again?(Process.get(:ids)[n], got)

  defp same?(%{"$id" => _} = want, got) do
    same?(Map.delete(want, "$id"), plain(got))
  end

  defp same?(%{"$value" => want}, got), do: same?(want, got)
  defp same?(%{"ticks" => ticks, "kind" => _}, got), do: got == ns(ticks)
  defp same?(%{"ticks" => ticks}, got), do: got == ticks * 100
  defp same?(%{"enum" => _, "value" => value}, got), do: got == value

  defp same?(%{"length" => n, "hex" => hex}, got),
    do: byte_size(got) == n and Base.encode16(got, case: :lower) == hex

  defp same?(%{"length" => n, "sha256" => hash}, got),
    do: byte_size(got) == n and Base.encode16(:crypto.hash(:sha256, got), case: :lower) == hash

  defp same?(%{"$pairs" => pairs}, got),
    do: map_size(got) == length(pairs) and Enum.all?(pairs, fn [k, v] -> same?(v, got[k]) end)

  defp same?(%{"count" => n, "first" => first, "last" => last}, got),
    do:
      length(got) == n and same?(first, Enum.take(got, length(first))) and
        same?(last, List.last(got))

  defp same?(%{"$type" => "Microsoft.Psi.Shared" <> _, "resource" => want}, got),
    do: picture?(want, got)

  defp same?(
         %{"$type" => "Microsoft.Psi.Audio.AudioBuffer", "format" => format, "data" => data},
         got
       ) do
    same?(data, got.data) and got.format.rate == format["SamplesPerSec"] and
      got.format.channels == format["Channels"] and got.format.sample == :s16
  end

  # The items of a tuple, in order.
  defp same?(%{"$type" => "System." <> _} = want, got) when is_tuple(got) do
    items = want |> Map.delete("$type") |> Enum.sort() |> Enum.map(&elem(&1, 1))
    same?(items, Tuple.to_list(got))
  end

  defp same?(%{"$type" => type} = want, got) when is_map(got) do
    # Fields excluded from serialization are in the expected objects, but not in the store.
    fields = want |> Map.delete("$type") |> Map.delete("NotAMember")
    told = Map.get(got, "$type", type)

    told == type and Map.keys(Map.delete(got, "$type")) == Map.keys(fields) and
      Enum.all?(fields, fn {key, value} -> same?(value, got[key]) end)
  end

  defp same?(want, got) when is_list(want) and is_list(got),
    do:
      length(want) == length(got) and Enum.all?(Enum.zip(want, got), fn {w, g} -> same?(w, g) end)

  defp same?("NaN", :nan), do: true
  defp same?("Infinity", :infinity), do: true
  defp same?("-Infinity", :neg_infinity), do: true

  defp same?(want, got) when is_number(want) and is_float(got),
    do: want == got or single(want) == single(got)

  defp same?(want, got), do: want === got

  # Maps each `$id` in `want` to the value read at its first occurrence.
  defp named(%{"$id" => n} = want, got, ids),
    do: named(Map.delete(want, "$id"), plain(got), Map.put(ids, n, got))

  defp named(%{"$value" => want}, got, ids), do: named(want, got, ids)

  defp named(want, got, ids) when is_map(want) and is_map(got) and not is_struct(got),
    do: Enum.reduce(want, ids, fn {key, value}, ids -> named(value, got[key], ids) end)

  defp named(want, got, ids) when is_list(want) and is_list(got),
    do: want |> Enum.zip(got) |> Enum.reduce(ids, fn {w, g}, ids -> named(w, g, ids) end)

  defp named(_want, _got, ids), do: ids

  defp plain(got) do
    with %{"$id" => _} <- got, do: Map.get(got, "$value", Map.delete(got, "$id"))
  end

  defp again?(first, %{"$ref" => id}), do: match?(%{"$id" => ^id}, first)
  defp again?(first, got), do: first == got

  defp picture?(want, got) do
    bytes = want["pixels"] || want["encoded"]

    same?(bytes, got.data) and {got.width, got.height} == {want["width"], want["height"]} and
      Map.get(got, :stride) == want["stride"]
  end

  defp single(x) do
    <<bits::32>> = <<x::float-32>>
    bits
  end
end
