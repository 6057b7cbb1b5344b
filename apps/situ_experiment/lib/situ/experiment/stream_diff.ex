defmodule Situ.Experiment.StreamDiff do
  @moduledoc false
  # Compares the streams of two recordings, message by message.
  alias Situ.{Message, Store}

  @type difference :: {stream :: String.t(), why :: String.t()}

  @doc """
  Returns the streams that differ, each with its first difference. `tolerances` maps streams to the largest difference
  of numbers in their data; all other streams must be equal.
  """
  @spec list_differences(Store.t(), Store.t(), %{String.t() => number()}) :: [difference()]
  def list_differences(first, second, tolerances \\ %{}) do
    names = fn store -> store |> Store.streams() |> Enum.map(& &1.name) end

    for name <- Enum.sort(Enum.uniq(names.(first) ++ names.(second))),
        why = compare_stream(first, second, name, tolerances[name]),
        do: {name, why}
  end

  @doc "Returns the first difference of a stream, or `nil` if it is equal in both recordings."
  @spec compare_stream(Store.t(), Store.t(), String.t(), number() | nil) :: String.t() | nil
  def compare_stream(first, second, name, tolerance) do
    cond do
      not Store.has_stream?(first, name) ->
        "only the second recording has it"

      not Store.has_stream?(second, name) ->
        "only the first recording has it"

      true ->
        compare_messages(Store.messages(first, name), Store.messages(second, name), tolerance)
    end
  end

  @doc """
  Compares messages with expected ones and returns the first difference, or `nil`.

      iex> m = fn t, data -> %Situ.Message{data: data, originating_time: t, creation_time: t, sequence_id: 1} end
      iex> Situ.Experiment.StreamDiff.compare_messages([m.(0, 1.0)], [m.(0, 1.05)], 0.1)
      nil
      iex> Situ.Experiment.StreamDiff.compare_messages([m.(0, 1.0)], [m.(5, 1.0)], nil)
      "message 1 is at 1970-01-01T00:00:00.000000005Z instead of 1970-01-01T00:00:00.000000000Z"
  """
  @spec compare_messages(Enumerable.t(), Enumerable.t(), number() | nil) :: String.t() | nil
  def compare_messages(expected, actual, tolerance) do
    padding = Stream.repeatedly(fn -> nil end)

    [Stream.concat(expected, padding), Stream.concat(actual, padding)]
    |> Stream.zip()
    |> Stream.take_while(&(&1 != {nil, nil}))
    |> Stream.with_index(1)
    |> Enum.find_value(fn {{a, b}, n} -> compare_pair(a, b, n, tolerance) end)
  end

  defp compare_pair(%Message{} = a, nil, n, _tolerance),
    do: "message #{n} is missing (#{format_time(a)})"

  defp compare_pair(nil, %Message{} = b, n, _tolerance),
    do: "message #{n} is surplus (#{format_time(b)})"

  defp compare_pair(a, b, n, tolerance) do
    cond do
      a.originating_time != b.originating_time ->
        "message #{n} is at #{format_time(b)} instead of #{format_time(a)}"

      same_value?(a.data, b.data, tolerance) ->
        nil

      true ->
        "message #{n} at #{format_time(a)} is #{inspect(b.data, limit: 8)} instead of #{inspect(a.data, limit: 8)}"
    end
  end

  defp format_time(message), do: Situ.Time.to_iso8601(message.originating_time)

  defp same_value?(a, b, nil), do: a === b

  defp same_value?(a, b, tolerance) when is_number(a) and is_number(b),
    do: abs(a - b) <= tolerance

  defp same_value?(a, b, tolerance) when is_struct(a) and is_struct(b),
    do:
      a.__struct__ == b.__struct__ and
        same_value?(Map.from_struct(a), Map.from_struct(b), tolerance)

  defp same_value?(a, b, tolerance) when is_map(a) and is_map(b) do
    Map.keys(a) == Map.keys(b) and
      Enum.all?(a, fn {key, x} -> same_value?(x, b[key], tolerance) end)
  end

  defp same_value?(a, b, tolerance) when is_tuple(a) and is_tuple(b),
    do: same_value?(Tuple.to_list(a), Tuple.to_list(b), tolerance)

  defp same_value?([x | a], [y | b], tolerance),
    do: same_value?(x, y, tolerance) and same_value?(a, b, tolerance)

  defp same_value?(a, b, _tolerance), do: a === b
end
