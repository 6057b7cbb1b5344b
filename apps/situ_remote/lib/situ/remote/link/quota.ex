defmodule Situ.Remote.Link.Quota do
  @moduledoc """
  The most that a server sends: bytes and messages a second, shared by its clients.

  The quota is a time at which everything sent so far is paid for (the generic cell rate algorithm, ITU-T I.371):
  sending adds its cost, and a sender more than a tenth of a second ahead waits for the rest. Any process may take
  from it.

      iex> alias Situ.Remote.Link.Quota
      iex> quota = Quota.new({:bytes_per_second, 1_000_000})
      iex> {Quota.take(quota, 100_000, 1, 0), Quota.take(quota, 50_000, 1, 0)}
      {0, 50_000_000}
      iex> Quota.take(Quota.new(nil), 1_000_000, 1, 0)
      0
  """
  @burst_ns 100_000_000

  defstruct limits: []

  @opaque t :: %__MODULE__{limits: [{:bytes | :messages, number(), :atomics.atomics_ref()}]}
  @type limit :: {:bytes_per_second | :messages_per_second, pos_integer()}

  @doc "Of no limit (`nil`), one, or a list of them."
  @spec new(nil | limit() | [limit()]) :: t()
  def new(nil), do: %__MODULE__{}

  def new(limits) do
    limits = for {unit, rate} <- List.wrap(limits), do: {unit_of(unit), 1.0e9 / rate, paid()}
    %__MODULE__{limits: limits}
  end

  # The monotonic clock begins far below zero.
  defp paid do
    paid = :atomics.new(1, signed: true)
    :atomics.put(paid, 1, -0x7FFFFFFFFFFFFFFF)
    paid
  end

  defp unit_of(:bytes_per_second), do: :bytes
  defp unit_of(:messages_per_second), do: :messages

  @doc "Counts what was sent at `now` (ns, monotonic); how long to wait before anything else is, ns."
  @spec take(t(), non_neg_integer(), non_neg_integer(), integer()) :: non_neg_integer()
  def take(%__MODULE__{limits: []}, _bytes, _messages, _now), do: 0

  def take(%__MODULE__{limits: limits}, bytes, messages, now) do
    limits
    |> Enum.map(fn
      {:bytes, cost, paid} -> pay(paid, round(bytes * cost), now)
      {:messages, cost, paid} -> pay(paid, round(messages * cost), now)
    end)
    |> Enum.max()
  end

  defp pay(paid, cost, now) do
    before = :atomics.get(paid, 1)
    until = max(before, now) + cost

    case :atomics.compare_exchange(paid, 1, before, until) do
      :ok -> max(until - now - @burst_ns, 0)
      _other -> pay(paid, cost, now)
    end
  end

  @doc "The bytes of a piece small enough that something more important waits for it no longer than 50 ms."
  @spec piece(t(), pos_integer()) :: pos_integer()
  def piece(%__MODULE__{limits: limits}, most) do
    case List.keyfind(limits, :bytes, 0) do
      {:bytes, cost, _} -> (0.05 * 1.0e9 / cost) |> round() |> max(4_096) |> min(most)
      nil -> most
    end
  end
end
