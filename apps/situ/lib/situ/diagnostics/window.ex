defmodule Situ.Diagnostics.Window do
  @moduledoc false
  # The traffic of a connection in the last averaging span. `Situ.Diagnostics.Snapshot`
  # documents the fields.

  defstruct span: 0,
            emitted: 0,
            processed: 0,
            dropped: 0,
            created: nil,
            posted: nil,
            latency: nil,
            handling: nil,
            queue: nil,
            size: nil

  @type t :: %__MODULE__{
          span: Situ.Time.duration(),
          emitted: non_neg_integer(),
          processed: non_neg_integer(),
          dropped: non_neg_integer(),
          created: Situ.Time.duration() | nil,
          posted: Situ.Time.duration() | nil,
          latency: Situ.Time.duration() | nil,
          handling: Situ.Time.duration() | nil,
          queue: float() | nil,
          size: non_neg_integer() | nil
        }

  @doc "Returns `part` as a percentage of `total`, or 0.0 if `total` is not positive."
  @spec percent(number(), number()) :: float()
  def percent(_part, total) when total <= 0, do: 0.0
  def percent(part, total), do: part * 100 / total

  @doc """
  Converts a count of the window to a rate per second.

      iex> window = %Situ.Diagnostics.Window{span: 2_000_000_000, emitted: 50, processed: 30, dropped: 10}
      iex> {Situ.Diagnostics.rate(window.processed, window), Situ.Diagnostics.percent(window.dropped, window.emitted)}
      {15.0, 20.0}
  """
  @spec rate(number(), t()) :: float()
  def rate(_n, %__MODULE__{span: 0}), do: 0.0
  def rate(n, %__MODULE__{span: span}), do: n * 1.0e9 / span
end
