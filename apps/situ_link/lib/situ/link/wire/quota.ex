defmodule Situ.Link.Wire.Quota do
  @moduledoc false
  # Limits the bytes and messages per second that a server sends, shared by its clients.
  #
  # The quota is the time by which everything sent so far is paid for (the generic cell rate
  # algorithm, ITU-T I.371). Sending adds its cost, and a sender that is more than a tenth of a
  # second ahead waits for the excess. Any process may use the quota.
  @burst_ns 100_000_000

  defstruct limits: []

  @opaque t :: %__MODULE__{limits: [{:bytes | :messages, number(), :atomics.atomics_ref()}]}
  @type limit :: {:bytes_per_second | :messages_per_second, pos_integer()}

  @doc """
  Builds a quota from `nil` (no limit), one limit, or a list of limits.

      iex> alias Situ.Link.Wire.Quota
      iex> quota = Quota.new({:bytes_per_second, 1_000_000})
      iex> {Quota.charge_sent(quota, 100_000, 1, 0), Quota.charge_sent(quota, 50_000, 1, 0)}
      {0, 50_000_000}
      iex> Quota.charge_sent(Quota.new(nil), 1_000_000, 1, 0)
      0
  """
  @spec new(nil | limit() | [limit()]) :: t()
  def new(nil), do: %__MODULE__{}

  def new(limits) do
    limits =
      for {unit, rate} <- List.wrap(limits), do: {unit_of(unit), 1.0e9 / rate, new_paid_until()}

    %__MODULE__{limits: limits}
  end

  # The monotonic clock may be negative, so the start value must be below any of its times.
  defp new_paid_until do
    paid = :atomics.new(1, signed: true)
    :atomics.put(paid, 1, -0x7FFFFFFFFFFFFFFF)
    paid
  end

  defp unit_of(:bytes_per_second), do: :bytes
  defp unit_of(:messages_per_second), do: :messages

  @doc "Charges data sent at `now` (ns, monotonic). Returns how long to wait before sending more, in ns."
  @spec charge_sent(t(), non_neg_integer(), non_neg_integer(), integer()) :: non_neg_integer()
  def charge_sent(%__MODULE__{limits: []}, _bytes, _messages, _now), do: 0

  def charge_sent(%__MODULE__{limits: limits}, bytes, messages, now) do
    limits
    |> Enum.map(fn
      {:bytes, cost, paid} -> advance_paid_until(paid, round(bytes * cost), now)
      {:messages, cost, paid} -> advance_paid_until(paid, round(messages * cost), now)
    end)
    |> Enum.max()
  end

  defp advance_paid_until(paid, cost, now) do
    before = :atomics.get(paid, 1)
    until = max(before, now) + cost

    case :atomics.compare_exchange(paid, 1, before, until) do
      :ok -> max(until - now - @burst_ns, 0)
      _other -> advance_paid_until(paid, cost, now)
    end
  end

  @doc "Returns a part size, at most `max` bytes, that delays more important data by no more than 50 ms."
  @spec segment_size(t(), pos_integer()) :: pos_integer()
  def segment_size(%__MODULE__{limits: limits}, max) do
    case List.keyfind(limits, :bytes, 0) do
      {:bytes, cost, _} -> (0.05 * 1.0e9 / cost) |> round() |> max(4_096) |> min(max)
      nil -> max
    end
  end
end
