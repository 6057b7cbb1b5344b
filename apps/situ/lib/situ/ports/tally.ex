defmodule Situ.Ports.Tally do
  @moduledoc false
  # Errors, restarts and lost messages of each component of a stage, in shared memory.

  @type t :: :counters.counters_ref()

  @spec new(pos_integer()) :: t()
  def new(vertices), do: :counters.new(vertices * 3, [])

  @spec failed(t(), non_neg_integer()) :: :ok
  def failed(ref, index), do: :counters.add(ref, index * 3 + 1, 1)

  @doc "Counts a message that was lost to an error."
  @spec skipped(t(), non_neg_integer()) :: :ok
  def skipped(ref, index) do
    failed(ref, index)
    :counters.add(ref, index * 3 + 3, 1)
  end

  @doc "Counts a restart of the component, which loses the current message."
  @spec restarted(t(), non_neg_integer()) :: :ok
  def restarted(ref, index) do
    skipped(ref, index)
    :counters.add(ref, index * 3 + 2, 1)
  end

  @spec read(t(), non_neg_integer()) :: %{
          errors: integer(),
          restarts: integer(),
          skipped: integer()
        }
  def read(ref, index) do
    %{
      errors: :counters.get(ref, index * 3 + 1),
      restarts: :counters.get(ref, index * 3 + 2),
      skipped: :counters.get(ref, index * 3 + 3)
    }
  end
end
