defmodule Situ.Python.Window do
  @moduledoc false
  # The number of messages that may be in flight to a worker: as many as it handles in about 5 ms. Fewer would leave it
  # idle between messages, and more would only delay them, and deliver old messages where a policy wants the latest.
  @target_ns 5_000_000
  @most 1_000

  defstruct limit: 4, least: 1, count: 0, full?: false

  @type t :: %__MODULE__{
          limit: pos_integer(),
          least: pos_integer(),
          count: non_neg_integer(),
          full?: boolean()
        }

  @doc "Builds a window for a worker that handles batches of up to `batch` messages: one batch can wait for another."
  @spec new(batch :: pos_integer()) :: t()
  def new(batch \\ 1)
  def new(1), do: %__MODULE__{}
  def new(batch), do: %__MODULE__{limit: max(4, 2 * batch), least: 2 * batch}

  @doc "Counts messages that were sent."
  @spec count_sent(t(), non_neg_integer()) :: t()
  def count_sent(window, n), do: note_full(%{window | count: window.count + n})

  @doc "Counts a message that has a result."
  @spec count_done(t()) :: t()
  def count_done(window), do: note_full(%{window | count: window.count - 1})

  # A full window takes messages again when half of it is free, so that they come in batches.
  defp note_full(window) do
    limit = if window.full?, do: div(window.limit, 2) + 1, else: window.limit
    %{window | full?: window.count >= limit}
  end

  @doc """
  Adapts the limit to the time that the worker has spent on `n` messages.

      iex> alias Situ.Python.Window
      iex> {Window.adapt(Window.new(), 1, 40_000_000).limit, Window.adapt(Window.new(), 4, 40_000).limit}
      {1, 7}
  """
  @spec adapt(t(), non_neg_integer(), non_neg_integer()) :: t()
  def adapt(window, 0, _spent_ns), do: window

  def adapt(window, n, spent_ns) do
    # The limit grows by half at most, so that one short measurement does not decide.
    most = min(window.limit + div(window.limit, 2) + 1, @most)

    note_full(%{
      window
      | limit: div(@target_ns * n, max(spent_ns, 1)) |> min(most) |> max(window.least)
    })
  end
end
