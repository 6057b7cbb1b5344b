defmodule Situ.Live.Connections do
  @moduledoc false
  # The open WebSockets of each server, with the time of the last message from each. A process that is blocked in a read
  # or write cannot watch itself, so `kill_idle/2` is called from another process.

  @spec register(reference()) :: :atomics.atomics_ref()
  def register(ref) do
    last_seen = :atomics.new(1, signed: true)
    touch(last_seen)
    {:ok, _} = Registry.register(__MODULE__, ref, last_seen)
    last_seen
  end

  @spec touch(:atomics.atomics_ref()) :: :ok
  def touch(last_seen), do: :atomics.put(last_seen, 1, System.monotonic_time(:millisecond))

  @spec count(reference()) :: non_neg_integer()
  def count(ref), do: length(list_pids(ref))

  # The registry removes an ended process slightly later than its monitors are notified.
  @spec list_pids(reference()) :: [pid()]
  def list_pids(ref),
    do: for({pid, _} <- Registry.lookup(__MODULE__, ref), Process.alive?(pid), do: pid)

  @doc "Kills connections that have sent nothing for `idle_ms`; returns their number."
  @spec kill_idle(reference(), integer()) :: non_neg_integer()
  def kill_idle(ref, idle_ms) do
    now = System.monotonic_time(:millisecond)

    idle =
      for {pid, last_seen} <- Registry.lookup(__MODULE__, ref),
          now - :atomics.get(last_seen, 1) > idle_ms,
          do: pid

    Enum.each(idle, &Process.exit(&1, :kill))
    length(idle)
  end
end
