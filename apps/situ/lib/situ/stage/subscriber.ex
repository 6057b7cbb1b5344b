defmodule Situ.Stage.Subscriber do
  @moduledoc false
  # One consumer of an output: its demand, and what waits for it. `monitor` is of one from outside the pipeline.
  alias Situ.Stage.Counters

  @enforce_keys [:tag, :pid]
  defstruct [
    :tag,
    :pid,
    :counters,
    :monitor,
    demand: 0,
    buffer: [],
    rear: [],
    size: 0,
    waiting: false
  ]

  @type t :: %__MODULE__{
          tag: term(),
          pid: pid(),
          counters: Counters.t() | nil,
          monitor: reference() | nil,
          demand: integer() | :infinity,
          buffer: [[Situ.Message.t()]],
          rear: [[Situ.Message.t()]],
          size: non_neg_integer(),
          waiting: boolean()
        }

  @doc "A subscriber without demand."
  @spec new(term(), pid(), Counters.t() | nil) :: t()
  def new(tag, pid, counters), do: %__MODULE__{tag: tag, pid: pid, counters: counters}

  @doc "The closing mark, behind the last message."
  @spec send_close(t(), Situ.Time.t()) :: term()
  def send_close(sub, time),
    do:
      send(
        sub.pid,
        {:"$gen_consumer", {self(), sub.tag}, {:cancel, {:shutdown, {:closed, time}}}}
      )

  @doc "Hands over `n` messages, as far as they were asked for; the rest waits. `ages`: of the last when made and posted, ns."
  @spec give(t(), [Situ.Message.t()], pos_integer(), {integer(), integer()}) :: t()
  def give(%{size: 0, demand: demand} = sub, messages, n, ages)
      when demand == :infinity or demand >= n do
    count(sub, n, ages)
    send(sub.pid, {:"$gen_consumer", {self(), sub.tag}, messages})
    %{sub | demand: minus(demand, n)}
  end

  def give(sub, messages, n, ages) do
    count(sub, n, ages)
    drain(%{sub | rear: [messages | sub.rear], size: sub.size + n})
  end

  @doc "More demand."
  @spec ask(t(), pos_integer() | :infinity) :: t()
  def ask(%__MODULE__{} = sub, n), do: drain(%{sub | demand: more(sub.demand, n)})

  defp drain(%{size: 0} = sub), do: note_waiting(sub, false)
  defp drain(%{demand: 0} = sub), do: note_waiting(sub, true)

  defp drain(%{buffer: [], rear: rear} = sub),
    do: drain(%{sub | buffer: Enum.reverse(rear), rear: []})

  defp drain(%{buffer: [batch | rest], demand: demand} = sub) do
    {now, later} = split(batch, demand)
    n = length(now)
    send(sub.pid, {:"$gen_consumer", {self(), sub.tag}, now})
    buffer = if later == [], do: rest, else: [later | rest]
    drain(%{sub | buffer: buffer, size: sub.size - n, demand: minus(demand, n)})
  end

  defp split(batch, :infinity), do: {batch, []}
  defp split(batch, n), do: Enum.split(batch, n)

  defp note_waiting(%{waiting: same} = sub, same), do: sub
  defp note_waiting(%{counters: nil} = sub, _flag), do: sub

  defp note_waiting(sub, flag) do
    Counters.waiting(sub.counters, if(flag, do: 1, else: 0))
    %{sub | waiting: flag}
  end

  defp count(%{counters: nil}, _n, _ages), do: :ok

  defp count(%{counters: counters}, n, {created, posted}),
    do: Counters.emitted(counters, n, created, posted)

  @doc "How many more it can take; negative while messages wait."
  @spec free(t()) :: integer() | :infinity
  def free(%{demand: :infinity}), do: :infinity
  def free(%{size: 0, demand: demand}), do: demand
  def free(%{size: size}), do: -size
  defp minus(:infinity, _n), do: :infinity
  defp minus(demand, n), do: demand - n
  defp more(:infinity, _n), do: :infinity
  defp more(_demand, :infinity), do: :infinity
  defp more(demand, n), do: demand + n
end
