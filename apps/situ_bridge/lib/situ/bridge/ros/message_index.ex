defmodule Situ.Bridge.Ros.MessageIndex do
  @moduledoc false
  # Packs the positions of a topic's messages in order of time: a time and two numbers for each message. Pure.

  @row_bytes 24

  @type t :: binary()
  @type row :: {Situ.Time.t(), non_neg_integer(), non_neg_integer()}

  @doc """
  Packs rows in order of time. Times strictly increase: rows with equal times are placed one nanosecond apart.

      iex> places = Situ.Bridge.Ros.MessageIndex.pack([{5, 2, 0}, {5, 1, 0}])
      iex> Situ.Bridge.Ros.MessageIndex.row_at(places, 1)
      {6, 2, 0}
  """
  @spec pack([row()]) :: t()
  def pack(rows) do
    {packed, _} =
      rows
      |> Enum.sort()
      |> Enum.map_reduce(nil, fn {time, a, b}, last ->
        time = if last, do: max(time, last + 1), else: time
        {<<time::signed-64, a::64, b::64>>, time}
      end)

    IO.iodata_to_binary(packed)
  end

  @spec count_rows(t()) :: non_neg_integer()
  def count_rows(positions), do: div(byte_size(positions), @row_bytes)

  @spec row_at(t(), non_neg_integer()) :: row()
  def row_at(positions, n) do
    <<time::signed-64, a::64, b::64>> = binary_part(positions, n * @row_bytes, @row_bytes)
    {time, a, b}
  end

  @doc "Returns the index of the first row at or after a time, or the number of rows if there is none."
  @spec seek(t(), Situ.Time.t()) :: non_neg_integer()
  def seek(positions, time), do: search_time(positions, time, 0, count_rows(positions))

  defp search_time(_positions, _time, low, high) when low >= high, do: low

  defp search_time(positions, time, low, high) do
    middle = div(low + high, 2)

    if elem(row_at(positions, middle), 0) < time,
      do: search_time(positions, time, middle + 1, high),
      else: search_time(positions, time, low, middle)
  end

  @doc "Returns at most `limit` rows from index `from` up to the time `to`, which may be `:unbounded`."
  @spec slice(t(), non_neg_integer(), Situ.Time.t() | :unbounded, pos_integer()) :: [row()]
  def slice(positions, from, to, limit) do
    last = if to == :unbounded, do: count_rows(positions) - 1, else: seek(positions, to + 1) - 1
    for n <- from..min(last, from + limit - 1)//1, do: row_at(positions, n)
  end
end
