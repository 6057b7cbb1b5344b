defmodule Situ.Window do
  @schema [
    with: [
      type: {:in, [:data, :messages]},
      default: :data,
      doc: "Whether the function receives data or complete messages."
    ]
  ]
  @by [
    with: [
      type: {:fun, 2},
      doc: "Builds the output: `fun.(window_message, messages)`; by default the list of data."
    ]
  ]

  @moduledoc """
  Windows over a stream: each message together with its neighbours.

  | window | contains | partial windows |
  |---|---|---|
  | a range of indices, `-2..0` | this message and the two before it | no output |
  | a `Situ.Interval` of ns | messages whose time is in the interval around this one's | output, also at the end |
  | a stream of windows | the messages in the interval returned for each window message | output; empty windows too |

  The output is the list of data, at the originating time of the message that the window belongs to (its anchor). It is
  emitted as soon as the window is known to be complete. All windows are reproducible.

      Situ.window(level, -9..0, &Enum.max/1)                                  # maximum of the last ten
      Situ.window(level, Situ.Interval.past(Situ.Time.s(1)), &Enum.max/1)     # maximum of the last second

      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable(1..5, every: 10) |> Situ.window(-2..0) end)
      [[1, 2, 3], [2, 3, 4], [3, 4, 5]]

  If the left end of a window is after its right end, the ends are swapped.

  ## Options

  #{Situ.Options.docs(@schema)}

  All options of every operator also apply (`Situ.Graph.Placement`).
  """

  alias Situ.Graph.Placement
  alias Situ.{Argument, Interval, Operator, Stream}
  alias Situ.Window.{ByStream, ByIndex, Component, ByTime}

  @doc """
  Emits windows of `stream` (see the table). `fun` builds the output of each window from its list. Without `fun`, the
  list is the output.
  """
  @spec window(Stream.t(), Range.t() | Interval.t(), (list() -> term()) | nil, keyword()) ::
          Stream.t()
  def window(stream, window, fun \\ nil, opts \\ [])

  def window(%Stream{} = stream, window, opts, []) when is_list(opts),
    do: window(stream, window, nil, opts)

  def window(%Stream{} = stream, window, fun, opts) when is_nil(fun) or is_function(fun, 1) do
    {own, placed} = Placement.split_options!(opts, @schema, :operator)
    type = if fun == nil, do: {:list, item_type(stream, own[:with])}, else: :any
    attach_window(stream, window, {fun, own[:with]}, {type, placed})
  end

  def window(other, _arg2, _arg3, _arg4),
    do:
      Argument.raise_invalid!(
        other,
        :stream,
        "Situ.window(stream, -2..0, fn list -> length(list) end)"
      )

  @doc """
  Emits a window per message of `windows`. `interval.(message)` returns `{interval, obsolete}`: the span of `stream` in
  the window (a `Situ.Interval` of time points), and the time before which no later window will need the stream. The
  output is at the window message's time.

  #{Situ.Options.docs(@by)}
  """
  @spec window_by(
          Stream.t(),
          Stream.t(),
          (Situ.Message.t() -> {Interval.t(), Situ.Time.t()}),
          keyword()
        ) :: Stream.t()
  def window_by(stream, windows, interval, opts \\ [])

  def window_by(%Stream{} = stream, %Stream{} = windows, interval, opts)
      when is_function(interval, 1) do
    {own, placed} = Placement.split_options!(opts, @by, :operator)
    creator = own[:with] || fn _window, messages -> Enum.map(messages, & &1.data) end
    core = {ByStream, :new, [interval, creator]}

    Operator.attach_component(
      [in: stream, windows: windows],
      "Window",
      {Component, [core: core]},
      placed
    )
  end

  def window_by(other, _arg2, _arg3, _arg4),
    do:
      Argument.raise_invalid!(
        other,
        :stream,
        "Situ.window_by(stream, windows, fn message -> {interval, time} end)"
      )

  # Windows that end at their anchor are complete when it arrives, so they run as light operators in a chain.
  defp attach_window(stream, %Range{first: from, last: to}, {fun, with}, {type, placed})
       when (to == 0 and from <= 0) or (from == 0 and to <= 0) do
    step = Situ.Window.Trailing.by_count(1 - min(from, to), fun, with)
    Operator.attach(stream, "Window", step, placed, type)
  end

  defp attach_window(stream, %Range{} = range, {fun, with}, {type, placed}) do
    core = {ByIndex, :new, [range, fun, [with: with]]}
    Operator.attach_component(stream, "Window", {Component, [core: core]}, placed, type)
  end

  defp attach_window(stream, %Interval{} = interval, {fun, with}, {type, placed}) do
    case Interval.sort_ends(interval) do
      %{right: 0, right_inclusive: true, left: left} = past when is_integer(left) ->
        step = Situ.Window.Trailing.by_time(past, fun, with)
        Operator.attach(stream, "Window", step, placed, type)

      ordered ->
        check_integer_ends!(ordered)
        core = {ByTime, :new, [ordered, fun, [with: with]]}
        Operator.attach_component(stream, "Window", {Component, [core: core]}, placed, type)
    end
  end

  defp attach_window(_stream, window, _fun, _rest) do
    raise ArgumentError,
          "a window is a range of indices or a Situ.Interval of ns, got: #{inspect(window)}"
  end

  defp check_integer_ends!(%{left: left, right: right}) do
    for bound <- [left, right], is_float(bound) do
      raise ArgumentError, "the ends of a window must be whole ns, got: #{bound}"
    end
  end

  defp item_type(stream, :data), do: stream.type
  defp item_type(stream, :messages), do: {:message, stream.type}
end
