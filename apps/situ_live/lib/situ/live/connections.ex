defmodule Situ.Live.Connections do
  @moduledoc false
  # The open WebSockets of each server, with the time something last came from each of them. A process blocked in
  # reading or writing cannot watch itself, so `sweep/2` is called from outside.

  @spec register(reference()) :: :atomics.atomics_ref()
  def register(ref) do
    seen = :atomics.new(1, signed: true)
    touch(seen)
    {:ok, _} = Registry.register(__MODULE__, ref, seen)
    seen
  end

  @spec touch(:atomics.atomics_ref()) :: :ok
  def touch(seen), do: :atomics.put(seen, 1, System.monotonic_time(:millisecond))

  @spec count(reference()) :: non_neg_integer()
  def count(ref), do: length(pids(ref))

  # A registry learns of a process's end a moment after its monitors do.
  @spec pids(reference()) :: [pid()]
  def pids(ref),
    do: for({pid, _} <- Registry.lookup(__MODULE__, ref), Process.alive?(pid), do: pid)

  @doc "Ends those from which nothing came for `idle_ms`; returns how many."
  @spec sweep(reference(), integer()) :: non_neg_integer()
  def sweep(ref, idle_ms) do
    now = System.monotonic_time(:millisecond)

    stale =
      for {pid, seen} <- Registry.lookup(__MODULE__, ref),
          now - :atomics.get(seen, 1) > idle_ms,
          do: pid

    Enum.each(stale, &Process.exit(&1, :kill))
    length(stale)
  end
end
