defmodule Situ.Filter.OneEuro do
  @moduledoc """
  The 1 euro filter: an adaptive low pass for irregular samples. Slow changes are smoothed, fast ones pass.

      iex> filter = Situ.Filter.OneEuro.new()
      iex> {first, filter} = Situ.Filter.OneEuro.step(filter, 0, 10.0)
      iex> {second, _filter} = Situ.Filter.OneEuro.step(filter, Situ.Time.ms(10), 20.0)
      iex> {first, Float.round(second, 4)}
      {10.0, 10.5912}

  Source: Casiez, Roussel, Vogel, 1 euro filter, CHI 2012.
  """

  @type t :: %__MODULE__{}
  defstruct slope: 0.0, min_cutoff: 1.0, derivative_cutoff: 1.0, previous: nil, derivative: 0.0

  @doc "`slope:` (default 0.0), `min_cutoff:` (Hz, default 1.0), `derivative_cutoff:` (Hz, default 1.0)."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: struct!(__MODULE__, opts)

  @doc "A sample at a time (ns); the first passes as it is."
  @spec step(t(), Situ.Time.t(), number()) :: {number(), t()}
  def step(%__MODULE__{previous: nil} = filter, time, sample),
    do: {sample, %{filter | previous: {time, sample}}}

  def step(%__MODULE__{previous: {before, out}} = filter, time, sample) do
    rate = 1.0e9 / (time - before)
    change = (sample - out) * rate
    derivative = blend(change, filter.derivative, alpha(rate, filter.derivative_cutoff))
    cutoff = filter.min_cutoff + filter.slope * abs(derivative)
    out = blend(sample, out, alpha(rate, cutoff))
    {out, %{filter | previous: {time, out}, derivative: derivative}}
  end

  defp blend(new, old, alpha), do: alpha * new + (1 - alpha) * old
  defp alpha(rate, cutoff), do: 1 / (1 + rate / (2 * :math.pi() * cutoff))
end
