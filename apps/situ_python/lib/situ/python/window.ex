defmodule Situ.Python.Window do
  @moduledoc false
  # The number of messages that may be in flight to a worker: as many as it handles in about 5 ms. Fewer would leave it
  # idle between messages, and more would only delay them, and deliver old messages where a policy wants the latest.
  @target_ns 5_000_000
  @most 1_000

  defstruct limit: 4, count: 0, done: 0, since: nil

  @type t :: %__MODULE__{
          limit: pos_integer(),
          count: non_neg_integer(),
          done: non_neg_integer(),
          since: integer() | nil
        }

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Counts a message that was sent."
  @spec count_sent(t(), integer()) :: t()
  def count_sent(window, now \\ System.monotonic_time())
  def count_sent(%{count: 0} = window, now), do: %{window | count: 1, done: 0, since: now}
  def count_sent(window, _now), do: %{window | count: window.count + 1}

  @doc "Counts a message that has a result."
  @spec count_done(t()) :: t()
  def count_done(window), do: %{window | count: window.count - 1, done: window.done + 1}

  @spec full?(t()) :: boolean()
  def full?(window), do: window.count >= window.limit

  @doc """
  Adapts the limit to the time that the messages since the last call have taken.

      iex> alias Situ.Python.Window
      iex> window = Window.new() |> Window.count_sent(0) |> Window.count_sent(0)
      iex> Window.adapt(window |> Window.count_done() |> Window.count_done(), 40_000_000).limit
      1
  """
  @spec adapt(t(), integer()) :: t()
  def adapt(window, now \\ System.monotonic_time())
  def adapt(%{done: 0} = window, _now), do: window

  def adapt(window, now) do
    taken = System.convert_time_unit(now - window.since, :native, :nanosecond)
    wanted = div(@target_ns * window.done, max(taken, 1))
    # The limit grows by at most half, so that one short measurement does not decide.
    limit = wanted |> min(window.limit + div(window.limit, 2) + 1) |> min(@most) |> max(1)
    %{window | limit: limit, done: 0, since: now}
  end
end
