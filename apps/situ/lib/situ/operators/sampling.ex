defmodule Situ.Sampling do
  @moduledoc """
  The pure heart of sampling at a fixed interval: the value of a stream at every tick, by an interpolator.

  Ticks are exact: the start, start + interval, ... or, with an alignment, the times congruent to it modulo the interval. They are
  made as the source advances and end with it, so nothing runs ahead of the data. A tick without a value gives no output.

      iex> sampling = Situ.Sampling.new(Situ.Reproducible.nearest(), 30, 0)
      iex> messages = for t <- [0, 20, 40], do: %Situ.Message{originating_time: t, data: t}
      iex> {outputs, _sampling} = Situ.Sampling.push(sampling, messages)
      iex> outputs
      [{:out, 0, 0}, {:out, 30, 40}]
  """

  alias Situ.{Interpolator, Message}

  @enforce_keys [:interpolator, :interval, :tick]
  defstruct [:interpolator, :interval, :tick, front: [], rear: [], last: nil]

  @type t :: %__MODULE__{
          interpolator: Interpolator.t(),
          interval: Situ.Time.duration(),
          tick: Situ.Time.t(),
          front: [Message.t()],
          rear: [[Message.t()]],
          last: Situ.Time.t() | nil
        }

  @doc "Ticks from `start` (or the first aligned time at or after it)."
  @spec new(Interpolator.t(), Situ.Time.duration(), Situ.Time.t(), Situ.Time.t() | nil) :: t()
  def new(%Interpolator{} = interpolator, interval, start, align \\ nil)
      when is_integer(interval) and interval > 0 do
    %__MODULE__{
      interpolator: interpolator,
      interval: interval,
      tick: first_tick(start, interval, align)
    }
  end

  @doc """
  The first time at or after `start` that is congruent to `align` modulo `interval`; `start` without an alignment.

      iex> Situ.Sampling.first_tick(7, 10, 0)
      10
      iex> Situ.Sampling.first_tick(20, 10, 0)
      20
  """
  @spec first_tick(Situ.Time.t(), Situ.Time.duration(), Situ.Time.t() | nil) :: Situ.Time.t()
  def first_tick(start, _interval, nil), do: start
  def first_tick(start, interval, align), do: start + Integer.mod(align - start, interval)

  @doc "Messages of the source arrived."
  @spec push(t(), [Message.t()]) :: {[Situ.Component.action()], t()}
  def push(sampling, []), do: {[], sampling}

  def push(sampling, messages) do
    last = List.last(messages).originating_time
    run(%{sampling | rear: [messages | sampling.rear], last: last}, last, nil, [])
  end

  @doc "The source ended at `time`: ticks up to and including it are decided."
  @spec close(t(), Situ.Time.t()) :: {[Situ.Component.action()], t()}
  def close(sampling, time), do: run(merge(sampling), time, time, [])

  defp run(%{tick: tick} = sampling, until, _closed, outputs) when tick > until,
    do: {Enum.reverse(outputs), sampling}

  defp run(%{tick: tick} = sampling, until, closed, outputs) do
    case Interpolator.interpolate(sampling.interpolator, tick, sampling.front, closed) do
      {:created, value, obsolete} ->
        run(step(sampling, obsolete), until, closed, [{:out, tick, value} | outputs])

      {:does_not_exist, obsolete} ->
        run(step(sampling, obsolete), until, closed, outputs)

      _undecided when sampling.rear != [] ->
        run(merge(sampling), until, closed, outputs)

      _undecided ->
        {Enum.reverse(outputs), sampling}
    end
  end

  defp step(sampling, nil), do: %{sampling | tick: sampling.tick + sampling.interval}

  defp step(sampling, obsolete) do
    front = Enum.drop_while(sampling.front, &(&1.originating_time < obsolete))
    %{sampling | tick: sampling.tick + sampling.interval, front: front}
  end

  defp merge(%{front: front, rear: rear} = sampling),
    do: %{sampling | front: front ++ Enum.concat(Enum.reverse(rear)), rear: []}
end
