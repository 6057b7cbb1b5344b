defmodule Situ.Aggregate do
  @moduledoc false
  # Folds and statistics over streams. `Situ` documents them; `Situ.Statistics` computes the values.

  @where [
    type: {:fun, 1},
    doc:
      "Includes only messages (or elements, with `over: :list`) for which it returns true; others cause no output."
  ]
  @schema [
    over: [
      type: :any,
      default: :all,
      doc:
        "The covered messages: `:all` so far, the `:list` in each message, `{:last, n}` messages, or `{:past, ns}`."
    ],
    where: @where,
    by: [
      type: {:fun, 1},
      doc: "Extracts the number from a message (or from an element, with `over: :list`)."
    ],
    nullable: [
      type: :boolean,
      doc:
        "Returns `nil` for the minimum, maximum or average of an empty list, instead of raising an error."
    ],
    initial: [
      type: :any,
      doc: "The running standard deviation after the first number, default `:nan`."
    ],
    compare: [
      type: {:fun, 2},
      doc:
        "For the minimum and maximum: returns true if the first value orders before or equal to the second."
    ]
  ]
  @base [type: :number, doc: "The base; the natural logarithm by default."]

  import Kernel, except: [abs: 1, max: 2, min: 2]

  alias Situ.Graph.Placement
  alias Situ.{Argument, Number, Operator, Statistics, Stream, Window}
  alias Situ.Statistics.Sliding

  @spec option_schema() :: Situ.Options.schema()
  def option_schema, do: @schema

  def scan(%Stream{} = stream, acc, fun, opts) when is_function(fun, 2) do
    step = fn data, _message, acc ->
      acc = fun.(data, acc)
      {:emit, acc, acc}
    end

    Operator.attach(stream, "Scan", {:step, step, acc}, opts)
  end

  def scan(%Stream{} = stream, acc, fun, opts) when is_function(fun, 3) do
    step = fn data, message, acc ->
      acc = fun.(data, message, acc)
      {:emit, acc, acc}
    end

    Operator.attach(stream, "Scan", {:step, step, acc}, opts)
  end

  def scan(other, _acc, _fun, _opts),
    do:
      Argument.raise_invalid!(
        other,
        :stream,
        "Situ.scan(stream, 0, fn data, acc -> data + acc end)"
      )

  def reduce(%Stream{} = stream, fun, opts) when is_function(fun, 2) do
    step = fn
      data, _message, :none -> {:emit, data, {:some, data}}
      data, _message, {:some, previous} -> emit_accumulated(fun.(data, previous))
    end

    Operator.attach(stream, "Reduce", {:step, step, :none}, opts, stream.type)
  end

  def reduce(other, _arg2, _arg3),
    do:
      Argument.raise_invalid!(
        other,
        :stream,
        "Situ.reduce(stream, fn data, acc -> data + acc end)"
      )

  defp emit_accumulated(value), do: {:emit, value, {:some, value}}

  def count(stream, opts), do: attach_statistic(stream, :count, opts)
  def sum(stream, opts), do: attach_statistic(stream, :sum, opts)
  def min(stream, opts), do: attach_statistic(stream, :min, opts)
  def max(stream, opts), do: attach_statistic(stream, :max, opts)
  def average(stream, opts), do: attach_statistic(stream, :average, opts)
  def std(stream, opts), do: attach_statistic(stream, :std, opts)

  def delta(stream, opts) do
    stream = Argument.ensure_stream!(stream, "Situ.delta(stream)")
    {stream, _own, placement} = split_and_filter(stream, opts, where: @where)
    fun = fn [this, next] -> Number.subtract(next, this) end
    Window.window(stream, 0..1, fun, put_default_name("Delta", placement))
  end

  def abs(stream, opts) do
    stream = Argument.ensure_stream!(stream, "Situ.abs(stream)")
    {stream, _own, placement} = split_and_filter(stream, opts, where: @where)
    Operator.attach(stream, "Abs", {:map, &Number.abs/1}, placement, stream.type)
  end

  def log(stream, opts) do
    stream = Argument.ensure_stream!(stream, "Situ.log(stream)")
    {stream, own, placement} = split_and_filter(stream, opts, where: @where, base: @base)
    Operator.attach(stream, "Log", {:map, log_function(own[:base])}, placement, :any)
  end

  defp log_function(nil), do: &Number.log/1

  defp log_function(base) when is_number(base) and base > 0 and base != 1 do
    scale = :math.log(base)
    &Number.divide(Number.log(&1), scale)
  end

  defp log_function(base) do
    raise ArgumentError, "base: must be a number above 0 other than 1, got: #{inspect(base)}"
  end

  defp attach_statistic(%Stream{} = stream, kind, opts) do
    {own, opts} = Placement.split_options!(opts, @schema, :operator)
    name = kind |> Atom.to_string() |> String.capitalize()
    attach_over(own[:over], stream, {kind, name, own}, opts)
  end

  defp attach_statistic(other, kind, _opts),
    do: Argument.raise_invalid!(other, :stream, "Situ.#{kind}(stream)")

  defp attach_over(:all, stream, {kind, name, own}, opts) do
    step = running_step(own[:where], own[:by])
    Operator.attach(stream, name, {:step, step, Statistics.initial_state(kind, own)}, opts, :any)
  end

  defp attach_over(:list, stream, {kind, name, own}, opts) do
    fun = fn list -> list |> select_numbers(own) |> list_statistic(kind, own) end
    Operator.attach(stream, name, {:map, fun}, opts, :any)
  end

  defp attach_over({:last, n}, stream, spec, opts) when is_integer(n) and n > 0,
    do: attach_sliding(stream, spec, opts, &last_n_step(&1, n))

  defp attach_over({:past, span}, stream, spec, opts) when is_integer(span) and span >= 0,
    do: attach_sliding(stream, spec, opts, &past_span_step(&1, span))

  defp attach_over(other, _stream, _spec, _opts) do
    raise ArgumentError,
          "over: must be :all, :list, {:last, n} or {:past, ns}, got: #{inspect(other)}"
  end

  defp attach_sliding(stream, {kind, name, own}, opts, step) do
    {stream, own} = apply_where(stream, own)
    window = Sliding.new(kind, Keyword.take(own, [:compare]))
    Operator.attach(stream, name, {:step, step.(own[:by] || (& &1)), window}, opts, :any)
  end

  defp last_n_step(by, n) do
    fn data, message, window ->
      window = if Sliding.size(window) == n, do: Sliding.pop(window), else: window
      window = Sliding.push(window, message.originating_time, by.(data))

      if Sliding.size(window) == n,
        do: {:emit, Sliding.current_result(window), window},
        else: {:skip, window}
    end
  end

  defp past_span_step(by, span) do
    fn data, %{originating_time: time}, window ->
      window = window |> Sliding.drop_before(time - span) |> Sliding.push(time, by.(data))
      {:emit, Sliding.current_result(window), window}
    end
  end

  defp apply_where(stream, own) do
    case Keyword.pop(own, :where) do
      {nil, own} -> {stream, own}
      {where, own} -> {Operator.attach(stream, "Filter", {:filter, where}, [], stream.type), own}
    end
  end

  defp split_and_filter(stream, opts, schema) do
    {own, placement} = Placement.split_options!(opts, schema, :operator)
    {stream, own} = apply_where(stream, own)
    {stream, own, placement}
  end

  defp put_default_name(name, opts), do: Keyword.put_new(opts, :default_name, name)

  defp select_numbers(list, own) do
    list = if own[:where], do: Enum.filter(list, own[:where]), else: list
    if own[:by], do: Enum.map(list, own[:by]), else: list
  end

  defp list_statistic(list, kind, own), do: Statistics.of_list(kind, list, own)

  defp running_step(nil, nil) do
    fn data, _message, state ->
      {result, state} = Statistics.add_value(state, data)
      {:emit, result, state}
    end
  end

  defp running_step(where, by) do
    fn data, _message, state ->
      if where == nil or where.(data) do
        {result, state} = Statistics.add_value(state, if(by == nil, do: data, else: by.(data)))
        {:emit, result, state}
      else
        {:skip, state}
      end
    end
  end
end
