defmodule Situ.Window.ByTime do
  @moduledoc false
  # The pure core of windows by time: for every message (the anchor), it collects all messages whose time is in the
  # window around it. A window is emitted, at its anchor's time, as soon as a message at or after its right end has
  # arrived, or the stream ends. Partial windows at the beginning and end of the stream are also emitted; a window
  # without messages is empty.
  alias Situ.{Interval, Message}

  # `queue`: messages from the first that the next anchor needs; `anchors`: messages whose window is undecided.
  @enforce_keys [:interval, :fun, :with]
  defstruct [:interval, :fun, :with, queue: [], anchors: []]

  @type t :: %__MODULE__{}

  @doc "Builds a window. `fun` takes the list of data, or the list of messages with `with: :messages`."
  @spec new(Interval.t(), (list() -> term()) | nil, keyword()) :: t()
  def new(%Interval{} = interval, fun, opts \\ []) do
    %__MODULE__{
      interval: Interval.sort_ends(interval),
      fun: fun,
      with: Keyword.get(opts, :with, :data)
    }
  end

  @doc """
  Adds messages and returns the windows they complete.

      iex> window = Situ.Window.ByTime.new(Situ.Interval.past(10), nil)
      iex> messages = for n <- 1..3, do: %Situ.Message{originating_time: n * 10, data: n}
      iex> {outputs, _window} = Situ.Window.ByTime.push(window, messages)
      iex> outputs
      [{:out, 10, [1]}, {:out, 20, [1, 2]}, {:out, 30, [2, 3]}]
  """
  @spec push(t(), [Message.t()]) :: {[Situ.Component.action()], t()}
  def push(window, []), do: {[], window}

  def push(window, messages) do
    newest = List.last(messages).originating_time
    queue = window.queue ++ messages
    emit_windows(%{window | anchors: window.anchors ++ messages}, queue, newest)
  end

  @doc "Marks the stream as ended and returns the remaining windows."
  @spec close(t()) :: {[Situ.Component.action()], t()}
  def close(window), do: emit_windows(window, window.queue, :closed)

  defp emit_windows(window, queue, newest) do
    {outputs, anchors, queue} = slide_anchors(window.anchors, queue, newest, window, [])
    {outputs, %{window | anchors: anchors, queue: queue}}
  end

  defp slide_anchors([%{originating_time: time} | rest] = anchors, queue, newest, window, outputs) do
    %{left: left, right: right} = window.interval

    # `:closed` is an atom and so sorts after every time.
    if newest == :closed or (right != :unbounded and newest >= time + right) do
      queue = drop_before_window(queue, time, left, window.interval.left_inclusive)

      content =
        take_window(queue, right_edge(time, right), window.interval.right_inclusive, window.with)

      value = if window.fun == nil, do: content, else: window.fun.(content)
      slide_anchors(rest, queue, newest, window, [{:out, time, value} | outputs])
    else
      {:lists.reverse(outputs), anchors, queue}
    end
  end

  defp slide_anchors([], queue, _newest, window, outputs),
    do: {:lists.reverse(outputs), [], trim_queue(queue, window.interval)}

  # If no anchors are left, drops messages that no later anchor can need.
  defp trim_queue([], _interval), do: []

  defp trim_queue(queue, %{left: left, left_inclusive: inclusive}) do
    case queue do
      [_only] -> queue
      _ when left == :unbounded -> queue
      _ -> drop_before_window(queue, List.last(queue).originating_time, left, inclusive)
    end
  end

  defp drop_before_window(queue, _time, :unbounded, _inclusive), do: queue

  defp drop_before_window([%{originating_time: at} | rest] = queue, time, left, inclusive) do
    if Interval.after_left?(at, time + left, inclusive),
      do: queue,
      else: drop_before_window(rest, time, left, inclusive)
  end

  defp drop_before_window([], _time, _left, _inclusive), do: []

  defp take_window([%{originating_time: at} = message | rest], right, inclusive, with) do
    if Interval.before_right?(at, right, inclusive) do
      item = if with == :data, do: message.data, else: message
      [item | take_window(rest, right, inclusive, with)]
    else
      []
    end
  end

  defp take_window([], _right, _inclusive, _with), do: []

  defp right_edge(_time, :unbounded), do: :unbounded
  defp right_edge(time, right), do: time + right
end
