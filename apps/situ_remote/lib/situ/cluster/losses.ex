defmodule Situ.Cluster.Losses do
  @moduledoc false
  # How often a node has lost a part lately, and how long it therefore waits before it takes that part again. Nodes that
  # are overloaded lose leases because they are; each takeover makes more work, so without a wait that grows they would
  # never come to rest. Pure.

  # In leases.
  @most 16
  @forgotten 60

  defstruct count: 0, at: nil, share: 1.0

  @typedoc "`share` spreads the nodes that lost a part at the same time."
  @type t :: %__MODULE__{count: non_neg_integer(), at: integer() | nil, share: float()}

  @doc "One more, at `now` (ms), with a lease of `lease` ms."
  @spec add(t(), integer(), pos_integer()) :: t()
  def add(%__MODULE__{} = losses, now, lease) do
    count = if forgotten?(losses, now, lease), do: 0, else: losses.count
    %{losses | count: count + 1, at: now, share: 0.5 + :rand.uniform() / 2}
  end

  @doc """
  Ms to wait beyond the lease: nothing after the first loss, then twice as long each time, up to #{@most} leases.

      iex> alias Situ.Cluster.Losses
      iex> losses = Enum.reduce(1..3, %Losses{}, &Losses.add(&2, &1 * 1_000, 1_000))
      iex> Losses.wait(losses, 3_000, 1_000) in 2_000..4_000
      true
      iex> Losses.wait(losses, 90_000, 1_000)
      0
  """
  @spec wait(t(), integer(), pos_integer()) :: non_neg_integer()
  def wait(%__MODULE__{count: count} = losses, now, lease) do
    if count < 2 or forgotten?(losses, now, lease),
      do: 0,
      else: round(min(Integer.pow(2, min(count, 10) - 1), @most) * lease * losses.share)
  end

  defp forgotten?(%{at: nil}, _now, _lease), do: true
  defp forgotten?(%{at: at}, now, lease), do: now - at > @forgotten * lease
end
