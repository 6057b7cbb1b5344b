defmodule Situ.Window do
  @moduledoc false
  # Windows over a stream: each message together with its neighbours. `Situ` documents them.

  @schema [
    with: [
      type: {:in, [:data, :messages, :columns]},
      default: :data,
      doc:
        "Whether the function receives data, complete messages, or `Situ.Columns` (of numbers; windows by index, or " <>
          "of the past)."
    ]
  ]
  @by [
    with: [
      type: {:fun, 2},
      doc: "Builds the output: `fun.(window_message, messages)`; by default the list of data."
    ]
  ]

  alias Situ.Graph.Placement
  alias Situ.{Argument, Interval, Operator, Stream}
  alias Situ.Window.{ByIndex, ByStream, ByTime, ColumnComponent, Component}

  @spec option_schema(:window | :window_by) :: Situ.Options.schema()
  def option_schema(:window), do: @schema
  def option_schema(:window_by), do: @by

  def window(%Stream{} = stream, window, opts, []) when is_list(opts),
    do: window(stream, window, nil, opts)

  def window(%Stream{} = stream, window, fun, opts) when is_nil(fun) or is_function(fun, 1) do
    {own, placement} = Placement.split_options!(opts, @schema, :operator)
    type = if fun == nil, do: {:list, item_type(stream, own[:with])}, else: :any
    attach_window(stream, window, {fun, own[:with]}, {type, placement})
  end

  def window(other, _arg2, _arg3, _arg4),
    do:
      Argument.raise_invalid!(
        other,
        :stream,
        "Situ.window(stream, -2..0, fn list -> length(list) end)"
      )

  def window_by(%Stream{} = stream, %Stream{} = windows, interval, opts)
      when is_function(interval, 1) do
    {own, placement} = Placement.split_options!(opts, @by, :operator)
    creator = own[:with] || fn _window, messages -> Enum.map(messages, & &1.data) end
    core = {ByStream, :new, [interval, creator]}

    Operator.attach_component(
      [in: stream, windows: windows],
      "Window",
      {Component, [core: core]},
      placement
    )
  end

  def window_by(other, _arg2, _arg3, _arg4),
    do:
      Argument.raise_invalid!(
        other,
        :stream,
        "Situ.window_by(stream, windows, fn message -> {interval, time} end)"
      )

  defp attach_window(_stream, _window, {nil, :columns}, _rest),
    do: raise(ArgumentError, "a window with: :columns needs a function of Situ.Columns")

  defp attach_window(stream, window, {fun, :columns}, {type, placement}) do
    case window do
      %Range{} -> attach_columns(stream, window, fun, {type, placement})
      %Interval{} -> attach_columns(stream, past_window!(window), fun, {type, placement})
      _ -> raise_window!(window)
    end
  end

  # Windows that end at their anchor are complete when it arrives, so they run as light operators in a chain.
  defp attach_window(stream, %Range{first: from, last: to}, {fun, with}, {type, placement})
       when (to == 0 and from <= 0) or (from == 0 and to <= 0) do
    step = Situ.Window.Trailing.by_count(1 - min(from, to), fun, with)
    Operator.attach(stream, "Window", step, placement, type)
  end

  defp attach_window(stream, %Range{} = range, {fun, with}, {type, placement}) do
    core = {ByIndex, :new, [range, fun, [with: with]]}
    Operator.attach_component(stream, "Window", {Component, [core: core]}, placement, type)
  end

  defp attach_window(stream, %Interval{} = interval, {fun, with}, {type, placement}) do
    case Interval.sort_ends(interval) do
      %{right: 0, right_inclusive: true, left: left} = past when is_integer(left) ->
        step = Situ.Window.Trailing.by_time(past, fun, with)
        Operator.attach(stream, "Window", step, placement, type)

      ordered ->
        check_integer_ends!(ordered)
        core = {ByTime, :new, [ordered, fun, [with: with]]}
        Operator.attach_component(stream, "Window", {Component, [core: core]}, placement, type)
    end
  end

  defp attach_window(_stream, window, _fun, _rest), do: raise_window!(window)

  defp attach_columns(stream, window, fun, {type, placement}) do
    component = {ColumnComponent, [window: window, fun: fun]}
    Operator.attach_component(stream, "Window", component, placement, type)
  end

  defp past_window!(interval) do
    case Interval.sort_ends(interval) do
      %{right: 0, right_inclusive: true, left: left} = past when is_integer(left) ->
        past

      other ->
        raise ArgumentError,
              "a window with: :columns ends at its own message, as Situ.Interval.past/1, got: #{inspect(other)}"
    end
  end

  defp raise_window!(window) do
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
