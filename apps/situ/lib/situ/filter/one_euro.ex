defmodule Situ.Filter.OneEuro do
  @moduledoc false
  # The 1 euro filter, an adaptive low-pass filter for irregular samples. `Situ.one_euro/2` documents its options.
  # Source: Casiez, Roussel, Vogel, 1 euro filter, CHI 2012.

  @options [
    slope: [
      type: :number,
      default: 0.0,
      doc: "How much the cutoff increases with the speed of change."
    ],
    min_cutoff: [type: :number, default: 1.0, doc: "Hz, the cutoff for a constant signal."],
    derivative_cutoff: [
      type: :number,
      default: 1.0,
      doc: "Hz, the cutoff for the speed of change."
    ]
  ]

  alias Situ.Number

  @type t :: %__MODULE__{}
  defstruct [:slope, :min_cutoff, :derivative_cutoff, :previous, derivative: 0.0]

  @doc "Builds a filter that has not received any samples."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: struct!(__MODULE__, Situ.Options.validate!(opts, @options))

  @doc false
  @spec option_schema() :: Situ.Options.schema()
  def option_schema, do: @options

  @doc """
  Filters a sample with its time (ns). The first sample passes unchanged. Once an output is `:nan` or infinite, so are
  all later outputs, since each output feeds into the next.

      iex> filter = Situ.Filter.OneEuro.new()
      iex> {first, filter} = Situ.Filter.OneEuro.step(filter, 0, 10.0)
      iex> {second, _filter} = Situ.Filter.OneEuro.step(filter, Situ.Time.ms(10), 20.0)
      iex> {first, Float.round(second, 4)}
      {10.0, 10.5912}
  """
  @spec step(t(), Situ.Time.t(), Number.t()) :: {Number.t(), t()}
  def step(%__MODULE__{previous: nil} = filter, time, sample) do
    sample = Number.add(0, sample)
    {sample, %{filter | previous: {time, sample}}}
  end

  def step(%__MODULE__{previous: {before, out}} = filter, time, sample) do
    rate = 1.0e9 / (time - before)
    change = sample |> Number.subtract(out) |> Number.multiply(rate)

    derivative =
      blend_values(change, filter.derivative, smoothing_factor(rate, filter.derivative_cutoff))

    speed = Number.multiply(filter.slope, Number.abs(derivative))
    out = blend_values(sample, out, smoothing_factor(rate, Number.add(filter.min_cutoff, speed)))
    {out, %{filter | previous: {time, out}, derivative: derivative}}
  end

  defp blend_values(new, old, alpha),
    do: Number.add(Number.multiply(alpha, new), Number.multiply(Number.subtract(1, alpha), old))

  # 1 / (1 + rate / (2 pi cutoff))
  defp smoothing_factor(rate, cutoff) do
    constant = Number.multiply(2 * :math.pi(), cutoff)
    Number.divide(1, Number.add(1, Number.divide(rate, constant)))
  end
end
