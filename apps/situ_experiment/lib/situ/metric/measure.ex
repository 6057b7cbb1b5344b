defmodule Situ.Metric.Measure do
  @moduledoc false
  # The behaviour of metrics. A measurement of one session is a map that JSON can represent. Measurements of several
  # sessions are merged, by default by adding their numbers, and values are computed from the result. A value is
  # undefined (`nil`) if its divisor is 0.

  @type counts :: %{String.t() => term()}

  @doc "Returns the names of the values, and whether higher or lower values are better."
  @callback directions() :: %{String.t() => :higher | :lower}
  @doc "Merges the measurements of two sessions."
  @callback merge_counts(counts(), counts()) :: counts()
  @doc "Computes the values of a measurement, or of merged ones."
  @callback compute_values(counts()) :: %{String.t() => number() | nil}
  @optional_callbacks merge_counts: 2

  @doc "Merges measurements of a metric's module; the list must not be empty."
  @spec merge_all(module(), [counts()]) :: counts()
  def merge_all(module, [first | rest]) do
    # A stored metric may be the first use of its module.
    merge =
      if Code.ensure_loaded?(module) and function_exported?(module, :merge_counts, 2),
        do: &module.merge_counts/2,
        else: fn a, b -> Map.merge(a, b, fn _, x, y -> x + y end) end

    Enum.reduce(rest, first, &merge.(&2, &1))
  end
end
