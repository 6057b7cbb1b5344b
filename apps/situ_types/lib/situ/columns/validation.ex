defmodule Situ.Columns.Validation do
  @moduledoc false
  # Checks columns: the fields fit to each other, floats are finite, and times increase. Every output checks columns,
  # so they note checked times and values, and the next outputs only compare these.
  alias Situ.{Columns, Error}
  alias Situ.Columns.Values

  @doc "Returns the first time that is not later than the one before it (the first: than `last`), or `nil`."
  @spec find_unordered(Columns.t(), Situ.Time.t() | nil) :: {Situ.Time.t(), Situ.Time.t()} | nil
  def find_unordered(%Columns{times: times} = columns, last) do
    <<first::little-signed-64, rest::binary>> = times

    cond do
      last != nil and first <= last ->
        {first, last}

      checked?(columns) ->
        nil

      true ->
        <<low::little-32, high::little-signed-32, _::binary>> = times
        find_unordered(rest, high, low)
    end
  end

  @doc "Notes that the times and values have been checked."
  @spec mark_checked(Columns.t(), boolean()) :: Columns.t()
  def mark_checked(columns, checked? \\ true)

  def mark_checked(%Columns{} = columns, true),
    do: %{columns | checked: {columns.times, columns.values}}

  def mark_checked(%Columns{} = columns, false), do: %{columns | checked: nil}

  @doc "Returns whether the times and values have been checked."
  @spec checked?(Columns.t()) :: boolean()
  def checked?(%{checked: {times, values}, times: times, values: values}), do: true
  def checked?(_columns), do: false

  @doc "Returns whether the times have been checked, perhaps together with other values."
  @spec times_checked?(Columns.t()) :: boolean()
  def times_checked?(%{checked: {times, _values}, times: times}), do: true
  def times_checked?(_columns), do: false

  # Halves of 32 bits are small integers of the VM; nanoseconds since 1970 are not.
  defp find_unordered(<<low::little-32, high::little-signed-32, rest::binary>>, before, below) do
    if high > before or (high == before and low > below) do
      find_unordered(rest, high, low)
    else
      {high * 0x100000000 + low, before * 0x100000000 + below}
    end
  end

  defp find_unordered(<<>>, _high, _low), do: nil

  @doc "Returns whether the messages have envelopes that continue after this sequence id and creation time."
  @spec continues?(Columns.t(), integer(), Situ.Time.t() | nil) :: boolean()
  def continues?(%Columns{sequence_id: id} = columns, last_id, last_creation),
    do: id != nil and id > last_id and creation_ordered?(columns, last_creation)

  defp creation_ordered?(%Columns{creation_times: times}, last) when is_binary(times) do
    <<low::little-32, high::little-signed-32, rest::binary>> = times
    <<first::little-signed-64, _::binary>> = times
    (last == nil or first >= last) and never_decreasing?(rest, high, low)
  end

  defp creation_ordered?(%Columns{creation_times: time}, last), do: last == nil or time >= last

  defp never_decreasing?(<<low::little-32, high::little-signed-32, rest::binary>>, before, below)
       when high > before or (high == before and low >= below),
       do: never_decreasing?(rest, high, low)

  defp never_decreasing?(rest, _high, _low), do: rest == <<>>

  @doc "Checks that the fields fit to each other, for columns that were not built by these functions."
  @spec validate(Columns.t()) :: :ok | {:error, Error.t()}
  def validate(%Columns{kind: kind, count: count, times: times, values: values} = columns)
      when kind in [:integer, :float, :boolean] and is_integer(count) and count > 0 and
             is_binary(times) and byte_size(times) == count * 8 and is_binary(values) do
    if byte_size(values) == count * Values.value_width(kind) and valid_envelope?(columns) and
         (checked?(columns) or Values.valid_values?(kind, values)),
       do: :ok,
       else: {:error, fields_error(columns)}
  end

  def validate(columns), do: {:error, fields_error(columns)}

  defp valid_envelope?(%{sequence_id: nil, creation_times: nil}), do: true

  defp valid_envelope?(%{sequence_id: id, creation_times: times, count: count})
       when is_integer(id) and id >= 0,
       do: is_integer(times) or (is_binary(times) and byte_size(times) == count * 8)

  defp valid_envelope?(_columns), do: false

  defp fields_error(columns) do
    Error.new(
      :not_columns,
      "the fields of #{inspect(Map.from_struct(columns), limit: 3)} do not fit to each other",
      why:
        "there are \"count\" times and values, floats are finite, and an envelope is complete or absent",
      fix: "build columns with Situ.Columns.new/2 and put_values/3"
    )
  end
end
