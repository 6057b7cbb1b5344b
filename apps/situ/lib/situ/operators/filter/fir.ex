defmodule Situ.Filter.Fir do
  @moduledoc """
  Finite impulse response filters: windowed sinc (Hamming), symmetric, so the phase is linear and the delay half the order.

      iex> taps = Situ.Filter.Fir.taps(:lowpass, 1_000, [50], 40)
      iex> length(taps)
      41
      iex> Float.round(Enum.sum(taps), 9)
      1.0

  Source: Oppenheim & Schafer, Discrete-Time Signal Processing, window method.
  """

  alias Situ.Number

  # `strange`: how many samples it takes until the last NaN or infinity has left the taps.
  @type t :: %__MODULE__{taps: [float()], past: [Number.t()], strange: non_neg_integer()}
  @enforce_keys [:taps]
  defstruct [:taps, past: [], strange: 0]

  @type shape :: :lowpass | :highpass | :bandpass | :bandstop

  @doc "A filter of this shape: `rate` and `edges` (one, or low and high) in Hz, an even `order`."
  @spec new(shape(), number(), [number()], pos_integer()) :: t()
  def new(shape, rate, edges, order) do
    taps = taps(shape, rate, edges, order)
    %__MODULE__{taps: taps, past: List.duplicate(0.0, length(taps))}
  end

  @doc "One sample in, one sample out. `:nan` and infinities come out, too, until they have left the taps."
  @spec step(t(), Number.t()) :: {Number.t(), t()}
  def step(%__MODULE__{taps: taps, past: past, strange: 0} = filter, sample)
      when is_number(sample) do
    {sum, past} = dot(taps, [sample | past], 0.0, [])
    {sum, %{filter | past: past}}
  rescue
    # Too large for a float.
    ArithmeticError -> strange(filter, sample, 0)
  end

  def step(%__MODULE__{} = filter, sample) when is_number(sample),
    do: strange(filter, sample, filter.strange - 1)

  def step(%__MODULE__{} = filter, sample), do: strange(filter, sample, length(filter.taps) - 1)

  defp strange(%{taps: taps, past: past} = filter, sample, left) do
    past = Enum.take([sample | past], length(taps))
    {Number.dot(taps, past), %{filter | past: past, strange: left}}
  end

  @doc "The impulse response, `order + 1` values (an odd order is raised by one)."
  @spec taps(shape(), number(), [number()], pos_integer()) :: [float()]
  def taps(shape, rate, edges, order) do
    half = div(order + 1, 2)

    case {shape, Enum.map(edges, &(&1 / rate))} do
      {:lowpass, [cutoff]} -> low(cutoff, half)
      {:highpass, [cutoff]} -> inverted(low(cutoff, half))
      {:bandpass, [from, to]} -> minus(low(to, half), low(from, half))
      {:bandstop, [from, to]} -> inverted(minus(low(to, half), low(from, half)))
    end
  end

  defp low(cutoff, half) do
    raw = for n <- -half..half, do: sinc(n, cutoff) * hamming(n, half)
    sum = Enum.sum(raw)
    Enum.map(raw, &(&1 / sum))
  end

  defp sinc(0, cutoff), do: 2 * cutoff
  defp sinc(n, cutoff), do: :math.sin(2 * :math.pi() * cutoff * n) / (:math.pi() * n)

  defp hamming(n, half), do: 0.54 + 0.46 * :math.cos(:math.pi() * n / half)

  defp minus(a, b), do: Enum.zip_with(a, b, &(&1 - &2))

  # What the filter takes away, from everything.
  defp inverted(taps) do
    taps |> Enum.map(&(-&1)) |> List.update_at(div(length(taps), 2), &(&1 + 1.0))
  end

  defp dot([tap | taps], [x | past], sum, kept), do: dot(taps, past, sum + tap * x, [x | kept])
  defp dot([], _past, sum, kept), do: {sum, :lists.reverse(kept)}
end
