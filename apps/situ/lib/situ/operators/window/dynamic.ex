defmodule Situ.Window.Dynamic do
  @moduledoc """
  The pure core of dynamic windows: each message of a window stream selects an interval of the source stream.

  `fun.(window_message)` returns `{interval, obsolete}`: an absolute `Situ.Interval`, and the time before which no later
  window will need the source. The output, at the window message's time, is `creator.(window_message, source_messages)`.
  It is emitted when a source message at or after the interval's right end has arrived, or when the source has ended.

  Errors (`Situ.Error`): `:window_negative`, `:window_not_finite`, `:window_before_obsolete`,
  `:obsolete_time_before_previous`.
  """

  alias Situ.{Error, Interval, Message}

  @enforce_keys [:fun, :creator]
  defstruct [:fun, :creator, :obsolete, :cleared, :reached, queue: [], windows: []]

  @type t :: %__MODULE__{}

  @doc "Builds a state with windows from `fun` and outputs from `creator`."
  @spec new(
          (Message.t() -> {Interval.t(), Situ.Time.t()}),
          (Message.t(), [Message.t()] -> term())
        ) ::
          t()
  def new(fun, creator), do: %__MODULE__{fun: fun, creator: creator}

  @doc "Adds source messages and returns the outputs they cause."
  @spec source(t(), [Message.t()]) :: {[Situ.Component.action()], t()}
  def source(core, []), do: {[], core}

  def source(core, messages) do
    reached = List.last(messages).originating_time
    run(%{core | queue: trim(core.queue ++ messages, core.cleared), reached: reached}, [])
  end

  @doc "Marks the source as ended. Every window is then decided using the messages that have arrived."
  @spec close_source(t()) :: {[Situ.Component.action()], t()}
  def close_source(core), do: run(%{core | reached: :closed}, [])

  @doc "Adds window messages and returns the outputs they cause."
  @spec window(t(), [Message.t()]) :: {[Situ.Component.action()], t()}
  def window(core, messages) do
    {windows, obsolete} =
      Enum.map_reduce(messages, core.obsolete, fn message, obsolete ->
        {interval, next} = core.fun.(message)
        check(interval, next, obsolete)
        {{message, interval, next}, next}
      end)

    run(%{core | windows: core.windows ++ windows, obsolete: obsolete}, [])
  end

  defp run(%{windows: [{message, interval, obsolete} | rest]} = core, outputs) do
    # `:closed` and `nil` sort after every time. `:closed` decides all windows, `nil` (no message yet) decides none.
    if core.reached != nil and core.reached >= interval.right do
      content = Enum.filter(core.queue, &Interval.contains?(interval, &1.originating_time))
      output = {:out, message.originating_time, core.creator.(message, content)}
      queue = trim(core.queue, obsolete)
      run(%{core | windows: rest, queue: queue, cleared: obsolete}, [output | outputs])
    else
      {Enum.reverse(outputs), core}
    end
  end

  defp run(core, outputs), do: {Enum.reverse(outputs), core}

  # The queue is trimmed by the obsolete time of the last emitted window, because waiting windows may need messages
  # that later windows do not.
  defp trim(queue, nil), do: queue
  defp trim(queue, obsolete), do: Enum.drop_while(queue, &(&1.originating_time < obsolete))

  defp check(%Interval{} = interval, obsolete, previous) do
    cond do
      not Interval.finite?(interval) ->
        refuse(
          :window_not_finite,
          "the window #{interval} has no #{missing(interval)}",
          "give it a beginning and an end"
        )

      Interval.negative?(interval) ->
        refuse(:window_negative, "the window #{interval} ends before it begins", "swap its ends")

      previous != nil and interval.left < previous ->
        refuse(
          :window_before_obsolete,
          "the window #{interval} begins before #{previous}, which an earlier one declared obsolete",
          "return an obsolete time that is not after the beginning of any later window"
        )

      previous != nil and obsolete < previous ->
        refuse(
          :obsolete_time_before_previous,
          "the obsolete time #{obsolete} is before the previous one, #{previous}",
          "return obsolete times that do not decrease"
        )

      true ->
        :ok
    end
  end

  defp check(other, _obsolete, _previous) do
    raise ArgumentError,
          "a window must be a Situ.Interval of time points, got: #{inspect(other)}"
  end

  defp missing(%{left: :unbounded, right: :unbounded}), do: "beginning and no end"
  defp missing(%{left: :unbounded}), do: "beginning"
  defp missing(_interval), do: "end"

  defp refuse(code, what, fix), do: raise(Error.new(code, what, fix: fix))
end
