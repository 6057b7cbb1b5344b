defmodule Situ.Filter.Iir do
  @moduledoc false
  # Infinite impulse response filters: Butterworth, as a chain of second-order sections. A filter with one edge has
  # `order` poles, and a band filter has `order` on each side (2 * `order` poles), as in SciPy and MATLAB.
  alias Situ.Filter.Butterworth
  alias Situ.Number

  @type t :: %__MODULE__{sections: [{Butterworth.section(), {Number.t(), Number.t()}}]}
  @enforce_keys [:sections]
  defstruct [:sections]

  @doc """
  Builds a filter. `rate` and `edges` (one, or low and high) are in Hz.

      iex> filter = Situ.Filter.Iir.new(:lowpass, 1_000, [50], 4)
      iex> length(filter.sections)
      2
      iex> length(Situ.Filter.Iir.new(:bandpass, 1_000, [45, 55], 4).sections)
      4
  """
  @spec new(Situ.Filter.Fir.shape(), number(), [number()], pos_integer()) :: t()
  def new(shape, rate, edges, order) do
    sections = Butterworth.design_sections(shape, Enum.map(edges, &(&1 / rate)), order)
    %__MODULE__{sections: Enum.map(sections, &{&1, {0.0, 0.0}})}
  end

  @doc "Filters one sample. The filter has infinite memory: after `:nan` or an infinity, it returns `:nan`."
  @spec step(t(), Number.t()) :: {Number.t(), t()}
  def step(%__MODULE__{sections: sections} = filter, sample) do
    {sections, out} = Enum.map_reduce(sections, sample, &step_section/2)
    {out, %{filter | sections: sections}}
  end

  # Transposed direct form II.
  defp step_section({{b0, b1, b2, a1, a2} = coefficients, {z1, z2}} = section, x)
       when is_number(x) and is_number(z1) and is_number(z2) do
    y = b0 * x + z1
    {{coefficients, {b1 * x - a1 * y + z2, b2 * x - a2 * y}}, y}
  rescue
    # The result was too large for a float.
    ArithmeticError -> step_non_finite(section, x)
  end

  defp step_section(section, x), do: step_non_finite(section, x)

  defp step_non_finite({{b0, b1, b2, a1, a2} = coefficients, {z1, z2}}, x) do
    y = Number.dot_product([b0, 1.0], [x, z1])
    z = {Number.dot_product([b1, -a1, 1.0], [x, y, z2]), Number.dot_product([b2, -a2], [x, y])}
    {{coefficients, z}, y}
  end
end
