defmodule Situ.Window.ByStream do
  @moduledoc false
  # The pure core of dynamic windows: each message of a window stream selects an interval of the source stream.
  #
  # `fun.(window_message)` returns `{interval, obsolete}`: an absolute `Situ.Interval`, and the time before which no
  # later window will need the source. The output, at the window message's time, is `creator.(window_message,
  # source_messages)`. It is emitted when a source message at or after the interval's right end has arrived, or when
  # the source has ended.
  #
  # Errors (`Situ.Error`): `:window_negative`, `:window_not_finite`, `:window_before_obsolete`,
  # `:obsolete_time_before_previous`.
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
  @spec push_source(t(), [Message.t()]) :: {[Situ.Component.action()], t()}
  def push_source(core, []), do: {[], core}

  def push_source(core, messages) do
    reached = List.last(messages).originating_time

    emit_decided(
      %{core | queue: drop_obsolete(core.queue ++ messages, core.cleared), reached: reached},
      []
    )
  end

  @doc "Marks the source as ended. Every window is then decided using the messages that have arrived."
  @spec close_source(t()) :: {[Situ.Component.action()], t()}
  def close_source(core), do: emit_decided(%{core | reached: :closed}, [])

  @doc "Adds window messages and returns the outputs they cause."
  @spec push_windows(t(), [Message.t()]) :: {[Situ.Component.action()], t()}
  def push_windows(core, messages) do
    {windows, obsolete} =
      Enum.map_reduce(messages, core.obsolete, fn message, obsolete ->
        {interval, next} = core.fun.(message)
        check_window(interval, next, obsolete)
        {{message, interval, next}, next}
      end)

    emit_decided(%{core | windows: core.windows ++ windows, obsolete: obsolete}, [])
  end

  defp emit_decided(%{windows: [{message, interval, obsolete} | rest]} = core, outputs) do
    # `:closed` and `nil` sort after every time. `:closed` decides all windows, `nil` (no message yet) decides none.
    if core.reached != nil and core.reached >= interval.right do
      content = Enum.filter(core.queue, &Interval.contains_point?(interval, &1.originating_time))
      output = {:out, message.originating_time, core.creator.(message, content)}
      queue = drop_obsolete(core.queue, obsolete)
      emit_decided(%{core | windows: rest, queue: queue, cleared: obsolete}, [output | outputs])
    else
      {Enum.reverse(outputs), core}
    end
  end

  defp emit_decided(core, outputs), do: {Enum.reverse(outputs), core}

  # The queue is trimmed by the obsolete time of the last emitted window, because waiting windows may need messages
  # that later windows do not.
  defp drop_obsolete(queue, nil), do: queue

  defp drop_obsolete(queue, obsolete),
    do: Enum.drop_while(queue, &(&1.originating_time < obsolete))

  defp check_window(%Interval{} = interval, obsolete, previous) do
    cond do
      not Interval.finite?(interval) ->
        raise_error(
          :window_not_finite,
          "the window #{interval} has no #{missing_ends(interval)}",
          "give it a beginning and an end"
        )

      Interval.negative?(interval) ->
        raise_error(
          :window_negative,
          "the window #{interval} ends before it begins",
          "swap its ends"
        )

      previous != nil and interval.left < previous ->
        raise_error(
          :window_before_obsolete,
          "the window #{interval} begins before #{previous}, which an earlier one declared obsolete",
          "return an obsolete time that is not after the beginning of any later window"
        )

      previous != nil and obsolete < previous ->
        raise_error(
          :obsolete_time_before_previous,
          "the obsolete time #{obsolete} is before the previous one, #{previous}",
          "return obsolete times that do not decrease"
        )

      true ->
        :ok
    end
  end

  defp check_window(other, _obsolete, _previous) do
    raise ArgumentError,
          "a window must be a Situ.Interval of time points, got: #{inspect(other)}"
  end

  defp missing_ends(%{left: :unbounded, right: :unbounded}), do: "beginning and no end"
  defp missing_ends(%{left: :unbounded}), do: "beginning"
  defp missing_ends(_interval), do: "end"

  defp raise_error(code, what, fix), do: raise(Error.new(code, what, fix: fix))
end
