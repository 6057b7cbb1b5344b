defmodule Situ.Ports.ErrorCounters do
  @moduledoc false
  # Errors, restarts and lost messages of each component of a stage, in shared memory.

  @type t :: :counters.counters_ref()

  @spec new(pos_integer()) :: t()
  def new(vertices), do: :counters.new(vertices * 3, [])

  @spec count_failure(t(), non_neg_integer()) :: :ok
  def count_failure(ref, index), do: :counters.add(ref, index * 3 + 1, 1)

  @doc "Counts a message that was lost to an error."
  @spec count_skip(t(), non_neg_integer()) :: :ok
  def count_skip(ref, index) do
    count_failure(ref, index)
    :counters.add(ref, index * 3 + 3, 1)
  end

  @doc "Counts a restart of the component, which loses the current message."
  @spec count_restart(t(), non_neg_integer()) :: :ok
  def count_restart(ref, index) do
    count_skip(ref, index)
    :counters.add(ref, index * 3 + 2, 1)
  end

  @spec read_counts(t(), non_neg_integer()) :: %{
          errors: integer(),
          restarts: integer(),
          skipped: integer()
        }
  def read_counts(ref, index) do
    %{
      errors: :counters.get(ref, index * 3 + 1),
      restarts: :counters.get(ref, index * 3 + 2),
      skipped: :counters.get(ref, index * 3 + 3)
    }
  end
end
