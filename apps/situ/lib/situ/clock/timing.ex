defmodule Situ.Clock.Timing do
  @moduledoc false
  # The clock, start time and replay interval of a pipeline. Pure except for reading the clock.
  alias Situ.Clock

  @enforce_keys [:clock, :start_time]
  defstruct [:clock, :start_time, enforce: false, replay_start: :unbounded, replay_end: :infinity]

  @typedoc "The time settings that a pipeline was started with."
  @type settings :: %{
          :clock => Clock.t() | nil,
          :interval => {bound(), bound()},
          :speed => number() | :max,
          optional(atom()) => term()
        }
  @type bound :: Situ.Time.t() | :unbounded
  @type t :: %__MODULE__{
          clock: Clock.t(),
          start_time: Situ.Time.t(),
          enforce: boolean(),
          replay_start: bound(),
          replay_end: Situ.Time.t() | :infinity
        }

  @doc "Chooses the clock, the start time and the replay end. The clock is virtual if the start is given or proposed."
  @spec new(settings(), [{Situ.Time.t(), bound()}]) :: t()
  def new(settings, proposals) do
    {from, to} = replay_interval(proposals, settings.interval)
    clock = choose_clock(settings, from)

    %__MODULE__{
      clock: clock,
      enforce: settings.speed != :max,
      start_time: if(from == :unbounded, do: Clock.now(clock), else: from),
      replay_start: from,
      replay_end: if(to == :unbounded, do: :infinity, else: to)
    }
  end

  @doc "Returns the replay interval: the union of the proposed intervals, limited to the requested interval."
  @spec replay_interval([{Situ.Time.t(), bound()}], {bound(), bound()}) :: {bound(), bound()}
  def replay_interval(proposals, requested),
    do: proposals |> proposed_interval() |> intersect_intervals(requested)

  defp proposed_interval([]), do: {:unbounded, :unbounded}

  defp proposed_interval(proposals) do
    from = proposals |> Enum.map(&elem(&1, 0)) |> Enum.min()
    ends = Enum.map(proposals, &elem(&1, 1))
    {from, if(:unbounded in ends, do: :unbounded, else: Enum.max(ends))}
  end

  defp intersect_intervals({from, to}, {asked_from, asked_to}) do
    from = latest_bound(from, asked_from)
    to = earliest_bound(to, asked_to)
    {from, if(is_integer(from) and is_integer(to), do: max(from, to), else: to)}
  end

  defp latest_bound(:unbounded, b), do: b
  defp latest_bound(a, :unbounded), do: a
  defp latest_bound(a, b), do: max(a, b)
  defp earliest_bound(:unbounded, b), do: b
  defp earliest_bound(a, :unbounded), do: a
  defp earliest_bound(a, b), do: min(a, b)

  defp choose_clock(%{clock: %Clock{} = clock}, _from), do: clock
  defp choose_clock(%{speed: speed}, :unbounded) when speed in [:max, 1.0, 1], do: Clock.real()

  defp choose_clock(%{speed: speed}, :unbounded),
    do: Clock.virtual(Clock.now(Clock.real()), speed)

  defp choose_clock(%{speed: :max}, from), do: Clock.virtual(from, 1.0)
  defp choose_clock(%{speed: speed}, from), do: Clock.virtual(from, speed)
end
