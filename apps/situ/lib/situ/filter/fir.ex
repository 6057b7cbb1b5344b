defmodule Situ.Filter.Fir do
  @moduledoc false
  # Finite impulse response filters, designed with a windowed sinc (Hamming). The taps are symmetric, so the phase is
  # linear and the delay is half the order. The gain is 1 in the middle of the pass band: at 0 Hz, at half the rate,
  # or at the centre of the band. Source: Oppenheim & Schafer, Discrete-Time Signal Processing, window method.
  alias Situ.Number

  # `non_finite`: the number of samples until the last NaN or infinity has left the taps.
  @type t :: %__MODULE__{taps: [float()], past: [Number.t()], non_finite: non_neg_integer()}
  @enforce_keys [:taps]
  defstruct [:taps, past: [], non_finite: 0]

  @type shape :: :lowpass | :highpass | :bandpass | :bandstop

  @doc "Builds a filter. `rate` and `edges` (one, or low and high) are in Hz, and `order` is even."
  @spec new(shape(), number(), [number()], pos_integer()) :: t()
  def new(shape, rate, edges, order) do
    taps = design_taps(shape, rate, edges, order)
    %__MODULE__{taps: taps, past: List.duplicate(0.0, length(taps))}
  end

  @doc "Filters one sample. `:nan` and infinities affect the output until they have left the taps."
  @spec step(t(), Number.t()) :: {Number.t(), t()}
  def step(%__MODULE__{taps: taps, past: past, non_finite: 0} = filter, sample)
      when is_number(sample) do
    {sum, past} = dot_and_shift(taps, [sample | past], 0.0, [])
    {sum, %{filter | past: past}}
  rescue
    # The result was too large for a float.
    ArithmeticError -> step_non_finite(filter, sample, 0)
  end

  def step(%__MODULE__{} = filter, sample) when is_number(sample),
    do: step_non_finite(filter, sample, filter.non_finite - 1)

  def step(%__MODULE__{} = filter, sample),
    do: step_non_finite(filter, sample, length(filter.taps) - 1)

  defp step_non_finite(%{taps: taps, past: past} = filter, sample, left) do
    past = Enum.take([sample | past], length(taps))
    {Number.dot_product(taps, past), %{filter | past: past, non_finite: left}}
  end

  @doc """
  Returns the impulse response of `order + 1` values (an odd order is raised by one).

      iex> taps = Situ.Filter.Fir.design_taps(:lowpass, 1_000, [50], 40)
      iex> length(taps)
      41
      iex> Float.round(Enum.sum(taps), 9)
      1.0
  """
  @spec design_taps(shape(), number(), [number()], pos_integer()) :: [float()]
  def design_taps(shape, rate, edges, order) do
    half = div(order + 1, 2)
    edges = Enum.map(edges, &(&1 / rate))

    # `at` is the frequency in the pass bands at which the gain is 1. Both are in cycles per sample.
    {bands, at} = pass_bands(shape, edges)
    raw = for n <- -half..half, do: ideal_response(bands, n) * hamming_weight(n, half)
    gain = Enum.sum(Enum.zip_with(raw, -half..half, &(&1 * :math.cos(2 * :math.pi() * at * &2))))
    Enum.map(raw, &(&1 / gain))
  end

  defp pass_bands(:lowpass, [cutoff]), do: {[{0.0, cutoff}], 0.0}
  defp pass_bands(:highpass, [cutoff]), do: {[{cutoff, 0.5}], 0.5}
  defp pass_bands(:bandpass, [low, high]), do: {[{low, high}], (low + high) / 2}
  defp pass_bands(:bandstop, [low, high]), do: {[{0.0, low}, {high, 0.5}], 0.0}

  defp ideal_response(bands, n),
    do: bands |> Enum.map(fn {low, high} -> sinc(n, high) - sinc(n, low) end) |> Enum.sum()

  defp sinc(0, cutoff), do: 2 * cutoff
  defp sinc(n, cutoff), do: :math.sin(2 * :math.pi() * cutoff * n) / (:math.pi() * n)

  defp hamming_weight(n, half), do: 0.54 + 0.46 * :math.cos(:math.pi() * n / half)

  defp dot_and_shift([tap | taps], [x | past], sum, shifted),
    do: dot_and_shift(taps, past, sum + tap * x, [x | shifted])

  defp dot_and_shift([], _past, sum, shifted), do: {sum, :lists.reverse(shifted)}
end
