defmodule Situ.Media.Recording.Waveform do
  @moduledoc false
  # A compact waveform of an audio stream. It stores the minimum, maximum, last value and count of
  # every non-empty interval of 2^24 ns (17 ms), packed (6 MB per hour), and merges them to the
  # width that a plot needs. Gaps take no space, however long they are according to the file.
  import Bitwise

  @level 24
  @bytes 28

  defstruct open: nil, parts: [], data: <<>>
  @type t :: %__MODULE__{}
  @type point :: {Situ.Time.t(), number(), number(), number(), pos_integer()}

  @doc "Returns the smallest bin width, as a power of two nanoseconds."
  @spec finest_level() :: pos_integer()
  def finest_level, do: @level

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  Adds points in time order, as returned by `Situ.AudioOps.points/2`.

      iex> alias Situ.Media.Recording.Waveform
      iex> points = for i <- 0..99, do: {i * 1_000_000, -i / 1, i / 1, i / 1, 8}
      iex> waveform = Waveform.new() |> Waveform.add_points(points) |> Waveform.pack_bins()
      iex> Waveform.list_bins(waveform, 0, 40_000_000, 25)
      [{0, -33.0, 33.0, 33.0, 272}, {33_554_432, -67.0, 67.0, 67.0, 272}]
  """
  @spec add_points(t(), [point()]) :: t()
  def add_points(waveform, points), do: Enum.reduce(points, waveform, &add_point/2)

  defp add_point({time, min, max, last, n}, %{open: {at, low, high, _, count}} = waveform)
       when time >>> @level <= at,
       do: %{waveform | open: {at, min(low, min), max(high, max), last, count + n}}

  defp add_point({time, min, max, last, n}, waveform),
    do: %{close_bin(waveform) | open: {time >>> @level, min, max, last, n}}

  defp close_bin(%{open: nil} = waveform), do: waveform

  defp close_bin(%{open: {at, min, max, last, n}} = waveform) do
    bin = <<at::signed-64, min::float-32, max::float-32, last::float-32, n::64>>
    %{waveform | open: nil, parts: [bin | waveform.parts]}
  end

  @doc "Packs the waveform after the last point was added."
  @spec pack_bins(t()) :: t()
  def pack_bins(waveform) do
    waveform = close_bin(waveform)
    %{waveform | data: waveform.parts |> Enum.reverse() |> IO.iodata_to_binary(), parts: []}
  end

  @doc "Returns the non-empty bins of 2^`level` ns (at least `finest_level/0`) that overlap `from..to`."
  @spec list_bins(t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) :: [point()]
  def list_bins(waveform, from, to, level) when level >= @level do
    # Extends the range to complete bins of the requested width.
    first = bin_index(waveform.data, from >>> level <<< (level - @level))
    last = bin_index(waveform.data, ((to >>> level) + 1) <<< (level - @level))

    waveform.data
    |> binary_part(first * @bytes, max(last - first, 0) * @bytes)
    |> fold_bins(level, nil, [])
  end

  # Returns the number of bins before number `at`.
  defp bin_index(data, at), do: search_bins(data, at, 0, div(byte_size(data), @bytes))
  defp search_bins(_data, _at, low, high) when low >= high, do: low

  defp search_bins(data, at, low, high) do
    middle = div(low + high, 2)
    <<number::signed-64>> = binary_part(data, middle * @bytes, 8)

    if number < at,
      do: search_bins(data, at, middle + 1, high),
      else: search_bins(data, at, low, middle)
  end

  defp fold_bins(
         <<at::signed-64, min::float-32, max::float-32, last::float-32, n::64, rest::binary>>,
         level,
         open,
         done
       ) do
    start = at >>> (level - @level) <<< level

    case open do
      {^start, low, high, _, count} ->
        fold_bins(rest, level, {start, min(low, min), max(high, max), last, count + n}, done)

      nil ->
        fold_bins(rest, level, {start, min, max, last, n}, done)

      _ ->
        fold_bins(rest, level, {start, min, max, last, n}, [open | done])
    end
  end

  defp fold_bins(<<>>, _level, nil, done), do: Enum.reverse(done)
  defp fold_bins(<<>>, _level, open, done), do: Enum.reverse([open | done])
end
