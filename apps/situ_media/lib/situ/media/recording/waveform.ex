defmodule Situ.Media.Recording.Waveform do
  @moduledoc """
  The outline of a sound, small enough to keep: minimum, maximum, last value and count of every 2^24 ns (17 ms), packed
  (4.3 MB an hour), and folded to the width a drawing needs.

      iex> alias Situ.Media.Recording.Waveform
      iex> points = for i <- 0..99, do: {i * 1_000_000, -i / 1, i / 1, i / 1, 8}
      iex> waveform = Waveform.new() |> Waveform.add(points) |> Waveform.finish()
      iex> Waveform.bins(waveform, 0, 40_000_000, 25)
      [{0, -33.0, 33.0, 33.0, 272}, {33_554_432, -67.0, 67.0, 67.0, 272}]
  """
  import Bitwise

  @level 24
  @bytes 20

  defstruct start: nil, open: nil, parts: [], data: <<>>
  @type t :: %__MODULE__{}
  @type point :: {Situ.Time.t(), number(), number(), number(), pos_integer()}

  @doc "The narrowest width it can answer, as a power of two nanoseconds."
  @spec level() :: pos_integer()
  def level, do: @level

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Takes in points in the order of time, as `Situ.AudioBuffer.points/2` gives them."
  @spec add(t(), [point()]) :: t()
  def add(waveform, points), do: Enum.reduce(points, waveform, &put/2)

  defp put({time, min, max, last, n}, %{open: {at, low, high, _, count}} = waveform)
       when time >>> @level <= at,
       do: %{waveform | open: {at, min(low, min), max(high, max), last, count + n}}

  defp put(point, %{open: nil} = waveform) do
    at = elem(point, 0) >>> @level
    begin(%{waveform | start: waveform.start || at}, at, point)
  end

  defp put(point, %{open: {at, _, _, _, _}} = waveform) do
    next = elem(point, 0) >>> @level
    gap = :binary.copy(<<0::size(@bytes)-unit(8)>>, next - at - 1)
    begin(%{close(waveform) | parts: [gap | close(waveform).parts]}, next, point)
  end

  defp begin(waveform, at, {_, min, max, last, n}),
    do: %{waveform | open: {at, min, max, last, n}}

  defp close(%{open: {_, min, max, last, n}} = waveform) do
    bin = <<min::float-32, max::float-32, last::float-32, n::64>>
    %{waveform | open: nil, parts: [bin | waveform.parts]}
  end

  @doc "Packs it, when nothing more comes."
  @spec finish(t()) :: t()
  def finish(%{open: nil} = waveform), do: %{waveform | start: waveform.start || 0}

  def finish(waveform) do
    waveform = close(waveform)
    %{waveform | data: waveform.parts |> Enum.reverse() |> IO.iodata_to_binary(), parts: []}
  end

  @doc "Bins 2^`level` ns wide (at least `level/0`) that meet `from..to`; empty ones are left out."
  @spec bins(t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) :: [point()]
  def bins(waveform, from, to, level) when level >= @level do
    count = div(byte_size(waveform.data), @bytes)
    # Whole bins of the width asked for.
    first = max((from >>> level <<< (level - @level)) - waveform.start, 0)
    last = min((((to >>> level) + 1) <<< (level - @level)) - 1 - waveform.start, count - 1)

    if last < first do
      []
    else
      data = binary_part(waveform.data, first * @bytes, (last - first + 1) * @bytes)
      fold(data, first + waveform.start, level, nil, [])
    end
  end

  defp fold(<<_::96, 0::64, rest::binary>>, at, level, open, done),
    do: fold(rest, at + 1, level, open, done)

  defp fold(
         <<min::float-32, max::float-32, last::float-32, n::64, rest::binary>>,
         at,
         level,
         open,
         done
       ) do
    start = at >>> (level - @level) <<< level

    case open do
      {^start, low, high, _, count} ->
        fold(rest, at + 1, level, {start, min(low, min), max(high, max), last, count + n}, done)

      nil ->
        fold(rest, at + 1, level, {start, min, max, last, n}, done)

      _ ->
        fold(rest, at + 1, level, {start, min, max, last, n}, [open | done])
    end
  end

  defp fold(<<>>, _at, _level, nil, done), do: Enum.reverse(done)
  defp fold(<<>>, _at, _level, open, done), do: Enum.reverse([open | done])
end
