defmodule Situ.Sampling do
  @moduledoc false
  # The pure core of sampling at a fixed interval: computes the value of a stream at every tick, with an interpolator.
  #
  # Ticks are exact: the start, start + interval, and so on. With an alignment, they are the times congruent to it
  # modulo the interval. Ticks are produced as the source advances and end with it, so they are never ahead of the
  # data. A tick without a value has no output. A long gap in the source contains many ticks. At most a few hundred
  # are produced at a time. As long as `more_ticks?/1` is true, `next_ticks/1` produces the next ones, so memory does
  # not depend on the gap.
  alias Situ.{Component, Interpolator, Message}
  alias Situ.Fusion.MessageQueue

  @slice 256

  @enforce_keys [:interpolator, :interval, :tick]
  defstruct [:interpolator, :interval, :tick, :until, :closed, queue: {[], []}, more?: false]

  @typedoc "`until`: the time that the source has reached; `closed`: the time at which it ended."
  @type t :: %__MODULE__{
          interpolator: Interpolator.t(),
          interval: Situ.Time.duration(),
          tick: Situ.Time.t(),
          until: Situ.Time.t() | nil,
          closed: Situ.Time.t() | nil,
          queue: MessageQueue.t(),
          more?: boolean()
        }

  @doc "Builds a sampling with ticks from `start`, or from the first aligned time at or after it."
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
  Returns the first time at or after `start` that is congruent to `align` modulo `interval`. Returns `start` if there is
  no alignment.

      iex> Situ.Sampling.first_tick(7, 10, 0)
      10
      iex> Situ.Sampling.first_tick(20, 10, 0)
      20
  """
  @spec first_tick(Situ.Time.t(), Situ.Time.duration(), Situ.Time.t() | nil) :: Situ.Time.t()
  def first_tick(start, _interval, nil), do: start
  def first_tick(start, interval, align), do: start + Integer.mod(align - start, interval)

  @doc """
  Adds messages of the source and returns the first of the outputs they cause.

      iex> sampling = Situ.Sampling.new(Situ.Reproducible.nearest(), 30, 0)
      iex> messages = for t <- [0, 20, 40], do: %Situ.Message{originating_time: t, data: t}
      iex> {outputs, _sampling} = Situ.Sampling.push(sampling, messages)
      iex> outputs
      [{:out, 0, 0}, {:out, 30, 40}]
  """
  @spec push(t(), [Message.t()]) :: {[Component.action()], t()}
  def push(sampling, []), do: {[], sampling}

  def push(sampling, messages) do
    until = MessageQueue.last_message(messages).originating_time
    next_ticks(%{sampling | queue: MessageQueue.push(sampling.queue, messages), until: until})
  end

  @doc "Marks the source as ended at `time`. Ticks up to and including that time are then decided."
  @spec close(t(), Situ.Time.t()) :: {[Component.action()], t()}
  def close(sampling, time),
    do:
      next_ticks(%{
        sampling
        | queue: MessageQueue.merge_batches(sampling.queue),
          until: time,
          closed: time
      })

  @doc """
  Returns whether there are ticks that can be decided now.

      iex> sampling = Situ.Sampling.new(Situ.Reproducible.linear(), 1, 0)
      iex> messages = for t <- [0, 1_000_000_000], do: %Situ.Message{originating_time: t, data: t}
      iex> {outputs, sampling} = Situ.Sampling.push(sampling, messages)
      iex> {length(outputs), Situ.Sampling.more_ticks?(sampling)}
      {256, true}
  """
  @spec more_ticks?(t()) :: boolean()
  def more_ticks?(sampling), do: sampling.more?

  @doc "Returns the outputs of the next ticks that can be decided."
  @spec next_ticks(t()) :: {[Component.action()], t()}
  def next_ticks(sampling), do: emit_ticks(sampling, @slice, [])

  defp emit_ticks(%{tick: tick, until: until} = sampling, _left, outputs) when tick > until,
    do: {:lists.reverse(outputs), %{sampling | more?: false}}

  defp emit_ticks(sampling, 0, outputs), do: {:lists.reverse(outputs), %{sampling | more?: true}}

  defp emit_ticks(%{tick: tick, queue: {front, rear}} = sampling, left, outputs) do
    case Interpolator.interpolate(sampling.interpolator, tick, front, sampling.closed) do
      {:created, value, obsolete} ->
        emit_ticks(advance_tick(sampling, obsolete), left - 1, [{:out, tick, value} | outputs])

      {:does_not_exist, obsolete} ->
        emit_ticks(advance_tick(sampling, obsolete), left - 1, outputs)

      _undecided when rear != [] ->
        emit_ticks(%{sampling | queue: MessageQueue.merge_batches(sampling.queue)}, left, outputs)

      _undecided ->
        {:lists.reverse(outputs), %{sampling | more?: false}}
    end
  end

  defp advance_tick(sampling, nil), do: %{sampling | tick: sampling.tick + sampling.interval}

  defp advance_tick(%{queue: {front, rear}} = sampling, obsolete) do
    front = Enum.drop_while(front, &(&1.originating_time < obsolete))
    %{sampling | tick: sampling.tick + sampling.interval, queue: {front, rear}}
  end
end
