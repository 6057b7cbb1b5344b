defmodule Situ.Filter.Iir do
  @moduledoc """
  Infinite impulse response filters: Butterworth, as a chain of second-order sections.

  A band pass is a high pass and a low pass in a row; a band stop is a chain of notches between its edges.

      iex> filter = Situ.Filter.Iir.new(:lowpass, 1_000, [50], 4)
      iex> length(filter.sections)
      2

  Source: R. Bristow-Johnson, Audio EQ Cookbook (bilinear transform), with Butterworth quality factors.
  """

  alias Situ.Number

  @type t :: %__MODULE__{sections: [{tuple(), {Number.t(), Number.t()}}]}
  @enforce_keys [:sections]
  defstruct [:sections]

  @doc "A filter: `rate` and `edges` (one, or low and high) in Hz; the order is raised to an even one."
  @spec new(Situ.Filter.Fir.shape(), number(), [number()], pos_integer()) :: t()
  def new(shape, rate, edges, order) do
    pairs = div(order + 1, 2)
    %__MODULE__{sections: Enum.map(coefficients(shape, rate, edges, pairs), &{&1, {0.0, 0.0}})}
  end

  @doc "One sample in, one sample out. Such a filter never forgets: after `:nan` or an infinity it gives `:nan`."
  @spec step(t(), Number.t()) :: {Number.t(), t()}
  def step(%__MODULE__{sections: sections} = filter, sample) do
    {sections, out} = Enum.map_reduce(sections, sample, &section/2)
    {out, %{filter | sections: sections}}
  end

  # Transposed direct form II.
  defp section({{b0, b1, b2, a1, a2} = coefficients, {z1, z2}} = section, x)
       when is_number(x) and is_number(z1) and is_number(z2) do
    y = b0 * x + z1
    {{coefficients, {b1 * x - a1 * y + z2, b2 * x - a2 * y}}, y}
  rescue
    # Too large for a float.
    ArithmeticError -> strange(section, x)
  end

  defp section(section, x), do: strange(section, x)

  defp strange({{b0, b1, b2, a1, a2} = coefficients, {z1, z2}}, x) do
    y = Number.dot([b0, 1.0], [x, z1])
    z = {Number.dot([b1, -a1, 1.0], [x, y, z2]), Number.dot([b2, -a2], [x, y])}
    {{coefficients, z}, y}
  end

  defp coefficients(:bandpass, rate, [from, to], pairs) do
    coefficients(:highpass, rate, [from], pairs) ++ coefficients(:lowpass, rate, [to], pairs)
  end

  defp coefficients(:bandstop, rate, [from, to], pairs) do
    center = :math.sqrt(from * to)
    List.duplicate(biquad(:notch, rate, center, center / (to - from)), pairs)
  end

  defp coefficients(shape, rate, [cutoff], pairs) do
    for k <- 1..pairs do
      q = 1 / (2 * :math.cos(:math.pi() * (2 * k - 1) / (4 * pairs)))
      biquad(shape, rate, cutoff, q)
    end
  end

  defp biquad(shape, rate, frequency, q) do
    w = 2 * :math.pi() * frequency / rate
    {cos, alpha} = {:math.cos(w), :math.sin(w) / (2 * q)}
    a0 = 1 + alpha

    {b0, b1, b2} =
      case shape do
        :lowpass -> {(1 - cos) / 2, 1 - cos, (1 - cos) / 2}
        :highpass -> {(1 + cos) / 2, -1 - cos, (1 + cos) / 2}
        :notch -> {1.0, -2 * cos, 1.0}
      end

    {b0 / a0, b1 / a0, b2 / a0, -2 * cos / a0, (1 - alpha) / a0}
  end
end
