defmodule Situ.Media.Recording.Waveform do
  @moduledoc """
  A compact waveform of an audio stream. It stores the minimum, maximum, last value and count of every non-empty
  interval of 2^24 ns (17 ms), packed (6 MB per hour), and merges them to the width that a plot needs. Gaps take no
  space, however long they are according to the file.

      iex> alias Situ.Media.Recording.Waveform
      iex> points = for i <- 0..99, do: {i * 1_000_000, -i / 1, i / 1, i / 1, 8}
      iex> waveform = Waveform.new() |> Waveform.add(points) |> Waveform.finish()
      iex> Waveform.bins(waveform, 0, 40_000_000, 25)
      [{0, -33.0, 33.0, 33.0, 272}, {33_554_432, -67.0, 67.0, 67.0, 272}]
  """
  import Bitwise

  @level 24
  @bytes 28

  defstruct open: nil, parts: [], data: <<>>
  @type t :: %__MODULE__{}
  @type point :: {Situ.Time.t(), number(), number(), number(), pos_integer()}

  @doc "Returns the smallest bin width, as a power of two nanoseconds."
  @spec level() :: pos_integer()
  def level, do: @level

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Adds points in time order, as returned by `Situ.Sound.points/2`."
  @spec add(t(), [point()]) :: t()
  def add(waveform, points), do: Enum.reduce(points, waveform, &put/2)

  defp put({time, min, max, last, n}, %{open: {at, low, high, _, count}} = waveform)
       when time >>> @level <= at,
       do: %{waveform | open: {at, min(low, min), max(high, max), last, count + n}}

  defp put({time, min, max, last, n}, waveform),
    do: %{close(waveform) | open: {time >>> @level, min, max, last, n}}

  defp close(%{open: nil} = waveform), do: waveform

  defp close(%{open: {at, min, max, last, n}} = waveform) do
    bin = <<at::signed-64, min::float-32, max::float-32, last::float-32, n::64>>
    %{waveform | open: nil, parts: [bin | waveform.parts]}
  end

  @doc "Packs the waveform after the last point was added."
  @spec finish(t()) :: t()
  def finish(waveform) do
    waveform = close(waveform)
    %{waveform | data: waveform.parts |> Enum.reverse() |> IO.iodata_to_binary(), parts: []}
  end

  @doc "Returns the non-empty bins of 2^`level` ns (at least `level/0`) that overlap `from..to`."
  @spec bins(t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) :: [point()]
  def bins(waveform, from, to, level) when level >= @level do
    # Extends the range to complete bins of the requested width.
    first = position(waveform.data, from >>> level <<< (level - @level))
    last = position(waveform.data, ((to >>> level) + 1) <<< (level - @level))

    waveform.data
    |> binary_part(first * @bytes, max(last - first, 0) * @bytes)
    |> fold(level, nil, [])
  end

  # Returns the number of bins before number `at`.
  defp position(data, at), do: position(data, at, 0, div(byte_size(data), @bytes))
  defp position(_data, _at, low, high) when low >= high, do: low

  defp position(data, at, low, high) do
    middle = div(low + high, 2)
    <<number::signed-64>> = binary_part(data, middle * @bytes, 8)

    if number < at,
      do: position(data, at, middle + 1, high),
      else: position(data, at, low, middle)
  end

  defp fold(
         <<at::signed-64, min::float-32, max::float-32, last::float-32, n::64, rest::binary>>,
         level,
         open,
         done
       ) do
    start = at >>> (level - @level) <<< level

    case open do
      {^start, low, high, _, count} ->
        fold(rest, level, {start, min(low, min), max(high, max), last, count + n}, done)

      nil ->
        fold(rest, level, {start, min, max, last, n}, done)

      _ ->
        fold(rest, level, {start, min, max, last, n}, [open | done])
    end
  end

  defp fold(<<>>, _level, nil, done), do: Enum.reverse(done)
  defp fold(<<>>, _level, open, done), do: Enum.reverse([open | done])
end
