defmodule Situ.Stage.Load do
  @moduledoc false
  # Measures the load of a stage in a shared process, and decides when it needs a process of its own. Pure.
  alias Situ.Ports.{Input, Outputs}
  alias Situ.Stage.State

  # A time slice of a stage ends after a millisecond, unless a single message takes longer.
  @blocking_ns 5_000_000
  @most_blocked 3
  # From so much time per message on, another process costs less than a tenth of it.
  @heavy_ns 5_000

  defstruct busy: 0, counted: 0, blocked: 0

  @typedoc """
  `busy` is the time (ns) for which the stage ran since the last check, and `counted` the number of messages until then.
  `blocked` counts runs that kept other stages waiting.
  """
  @type t :: %__MODULE__{
          busy: non_neg_integer(),
          counted: non_neg_integer(),
          blocked: non_neg_integer()
        }

  @doc "Adds a run of the stage, of `elapsed` ns, after which it has this state."
  @spec add_run(t(), integer(), State.t()) :: t()
  def add_run(%__MODULE__{} = load, elapsed, _state) when elapsed < @blocking_ns,
    do: %{load | busy: load.busy + elapsed}

  def add_run(%__MODULE__{} = load, elapsed, state) do
    slow? = Enum.any?(State.list_steps(state), &(&1.source.kind != nil or &1.work.slice <= 4))
    blocked = if slow?, do: load.blocked + 1, else: load.blocked
    %{load | busy: load.busy + elapsed, blocked: blocked}
  end

  @doc "Returns whether the stage has kept others waiting repeatedly."
  @spec blocking?(t()) :: boolean()
  def blocking?(%__MODULE__{blocked: blocked}), do: blocked >= @most_blocked

  @doc "Returns the time (ns) per message since the last check."
  @spec time_per_message(State.t()) :: non_neg_integer()
  def time_per_message(%State{load: load} = state),
    do: div(load.busy, max(count_messages(state) - load.counted, 1))

  @doc "Returns whether a message of the stage takes so long that its own process costs little in comparison."
  @spec heavy?(State.t()) :: boolean()
  def heavy?(state), do: time_per_message(state) >= @heavy_ns

  @doc "Begins the next measurement."
  @spec start_check(State.t()) :: State.t()
  def start_check(%State{load: load} = state),
    do: %{state | load: %{load | busy: 0, counted: count_messages(state)}}

  defp count_messages(state) do
    state
    |> State.list_steps()
    |> Enum.map(fn step ->
      taken = for {_tag, input} <- step.inputs.by_tag, do: Input.taken_count(input)
      posted = for output <- Outputs.list_all(step.outputs), do: output.seq
      max(Enum.sum(taken), Enum.max(posted, fn -> 0 end))
    end)
    |> Enum.max()
  end
end
