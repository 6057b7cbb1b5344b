defmodule Situ.Window.ByIndex do
  @moduledoc false
  # The pure core of windows by index: `-2..0` is this message and the two before it. Only complete windows are
  # emitted, each when the last message it needs has arrived, at the anchor's originating time.
  alias Situ.Message

  # The queue starts at the first message that the next window or its anchor needs, and offsets are relative to it.
  @enforce_keys [:need, :anchor, :skip, :size, :fun, :with]
  defstruct [:need, :anchor, :skip, :size, :fun, :with, queue: [], count: 0]

  @type t :: %__MODULE__{}

  @doc """
  Builds a window of these relative indices. `fun` builds the output from the list of data, or from the list of
  messages with `with: :messages`. If the left end of the range is after its right end, the ends are swapped.
  """
  @spec new(Range.t(), (list() -> term()) | nil, keyword()) :: t()
  def new(%Range{first: from, last: to}, fun, opts \\ []) do
    {from, to} = {min(from, to), max(from, to)}
    start = min(from, 0)

    %__MODULE__{
      need: max(to, 0) - start + 1,
      anchor: -start,
      skip: from - start,
      size: to - from + 1,
      fun: fun,
      with: Keyword.get(opts, :with, :data)
    }
  end

  @doc """
  Adds messages and returns the windows they complete.

      iex> window = Situ.Window.ByIndex.new(-1..0, &Enum.sum/1)
      iex> messages = for n <- 1..3, do: %Situ.Message{originating_time: n * 10, data: n}
      iex> {outputs, _window} = Situ.Window.ByIndex.push(window, messages)
      iex> outputs
      [{:out, 20, 3}, {:out, 30, 5}]
  """
  @spec push(t(), [Message.t()]) :: {[Situ.Component.action()], t()}
  def push(%{need: need} = window, messages) do
    count = window.count + length(messages)
    queue = window.queue ++ messages

    if count < need do
      {[], %{window | queue: queue, count: count}}
    else
      {outputs, queue} = slide_window(queue, count - need + 1, window, [])
      {outputs, %{window | queue: queue, count: need - 1}}
    end
  end

  defp slide_window(queue, 0, _window, outputs), do: {:lists.reverse(outputs), queue}

  defp slide_window([_ | rest] = queue, left, window, outputs) do
    %{originating_time: time} = nth_message(queue, window.anchor)
    content = window_content(nth_tail(queue, window.skip), window.size, window.with)
    value = if window.fun == nil, do: content, else: window.fun.(content)
    slide_window(rest, left - 1, window, [{:out, time, value} | outputs])
  end

  defp window_content(list, size, :data), do: take_data(list, size)
  defp window_content(list, size, :messages), do: Enum.take(list, size)

  defp take_data(_list, 0), do: []
  defp take_data([%{data: data} | rest], left), do: [data | take_data(rest, left - 1)]

  defp nth_message([head | _], 0), do: head
  defp nth_message([_ | rest], n), do: nth_message(rest, n - 1)

  defp nth_tail(list, 0), do: list
  defp nth_tail([_ | rest], n), do: nth_tail(rest, n - 1)
end
