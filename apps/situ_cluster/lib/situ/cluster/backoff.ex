defmodule Situ.Cluster.Backoff do
  @moduledoc false
  # Computes how long a node waits before it takes a part that it has lost recently. An overloaded node loses leases,
  # and each takeover adds to its load, so without a growing delay such nodes would never recover. Pure.

  # The maximum delay, and the time after which losses are forgotten, both in multiples of the lease.
  @max_factor 16
  @expiry_factor 60

  defstruct count: 0, lost_at: nil, share: 1.0

  @typedoc "`count` losses, the last at `lost_at` (ms); `share` spreads the nodes that lost a part at the same time."
  @type t :: %__MODULE__{count: non_neg_integer(), lost_at: integer() | nil, share: float()}

  @doc "Counts a loss at `now` (ms); a lease lasts `lease` ms."
  @spec add_loss(t(), integer(), pos_integer()) :: t()
  def add_loss(%__MODULE__{} = backoff, now, lease) do
    count = if losses_expired?(backoff, now, lease), do: 0, else: backoff.count
    %{backoff | count: count + 1, lost_at: now, share: 0.5 + :rand.uniform() / 2}
  end

  @doc """
  Returns the ms to wait beyond the lease: zero after the first loss, then twice as long after each loss, up to
  #{@max_factor} leases.

      iex> alias Situ.Cluster.Backoff
      iex> backoff = Enum.reduce(1..3, %Backoff{}, &Backoff.add_loss(&2, &1 * 1_000, 1_000))
      iex> Backoff.wait_ms(backoff, 3_000, 1_000) in 2_000..4_000
      true
      iex> Backoff.wait_ms(backoff, 90_000, 1_000)
      0
  """
  @spec wait_ms(t(), integer(), pos_integer()) :: non_neg_integer()
  def wait_ms(%__MODULE__{count: count} = backoff, now, lease) do
    if count < 2 or losses_expired?(backoff, now, lease),
      do: 0,
      else: round(min(Integer.pow(2, min(count, 10) - 1), @max_factor) * lease * backoff.share)
  end

  defp losses_expired?(%{lost_at: nil}, _now, _lease), do: true

  defp losses_expired?(%{lost_at: lost_at}, now, lease),
    do: now - lost_at > @expiry_factor * lease
end
