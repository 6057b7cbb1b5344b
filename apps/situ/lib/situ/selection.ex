defmodule Situ.Selection do
  @moduledoc false
  # Operators on the messages of one stream: functions on data, and selecting, moving and editing messages. `Situ`
  # documents them.

  @process [
    on_close: [
      type: {:fun, 2},
      doc:
        "Returns a last list of `{time, data}` at the stream's end: `fun.(closing_time, state)`."
    ]
  ]
  @columns [
    columns: [
      type: :boolean,
      default: false,
      doc:
        "The function takes `Situ.Columns`: many messages of plain numbers together. `map/3` expects as many " <>
          "values: a list, a binary of the same kind, or `{kind, binary}`."
    ]
  ]
  @reorder [
    time: [
      type: {:fun, 1},
      doc: "Returns the time of a message, ns; by default its originating time."
    ],
    late: [
      type: {:in, [:drop, :error]},
      default: :drop,
      doc: "Whether a message beyond the allowed lateness is dropped or is an error."
    ]
  ]

  alias Situ.Graph.Placement
  alias Situ.{Argument, Generator, Operator, Stream}
  alias Situ.Operator.ColumnFunction
  alias Situ.Selection.{Delay, Edit, Last, Process, Reorder}

  @spec option_schema(:process | :reorder | :columns) :: Situ.Options.schema()
  def option_schema(:process), do: @process
  def option_schema(:reorder), do: @reorder
  def option_schema(:columns), do: @columns

  def map(stream, fun, opts) do
    stream = ensure_stream!(stream, "map")
    {columns?, opts} = pop_columns(opts)

    if columns?,
      do: attach_columns(stream, "Map", [fun: fun], opts, :any),
      else: Operator.attach(stream, "Map", {:map, fun}, opts)
  end

  defp pop_columns(opts) do
    {own, placement} = Placement.split_options!(opts, @columns, :operator)
    {own[:columns], placement}
  end

  defp attach_columns(stream, name, own, opts, type),
    do: Operator.attach_component(stream, name, {ColumnFunction, own}, opts, type)

  def filter(stream, fun, opts) do
    stream = ensure_stream!(stream, "filter")
    Operator.attach(stream, "Filter", {:filter, fun}, opts, stream.type)
  end

  def each(stream, fun, opts) do
    stream = ensure_stream!(stream, "each")
    {columns?, opts} = pop_columns(opts)

    if columns?,
      do: attach_columns(stream, "Each", [fun: fun, replace: false], opts, stream.type),
      else: Operator.attach(stream, "Each", {:each, fun}, opts, stream.type)
  end

  defp ensure_stream!(stream, name),
    do: Argument.ensure_stream!(stream, "Situ.#{name}(stream, fn data -> data end)")

  def first(%Stream{} = stream, opts, []) when is_list(opts), do: first(stream, 1, opts)

  def first(%Stream{} = stream, n, opts) when is_integer(n) and n >= 0 do
    step = fn
      _data, _message, 0 -> {:skip, 0}
      data, _message, left -> {:emit, data, left - 1}
    end

    Operator.attach(stream, "First", {:step, step, n}, opts, stream.type)
  end

  def first(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.first(stream, 3)")

  def last(%Stream{} = stream, opts, []) when is_list(opts), do: last(stream, 1, opts)

  def last(%Stream{} = stream, n, opts) when is_integer(n) and n >= 0,
    do: Operator.attach_component(stream, "Last", {Last, [count: n]}, opts, stream.type)

  def last(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.last(stream, 3)")

  def map_present(%Stream{} = stream, fun, opts) when is_function(fun, 1) do
    Operator.attach(stream, "MapPresent", {:map, &if(&1 == nil, do: nil, else: fun.(&1))}, opts)
  end

  def map_present(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.map_present(stream, fn data -> data end)")

  def time_of(%Stream{} = stream, opts) do
    step = {:map, fn _data, message -> message.originating_time end}
    Operator.attach(stream, "TimeOf", step, opts, :integer)
  end

  def time_of(other, _arg2), do: Argument.raise_invalid!(other, :stream, "Situ.time_of(stream)")

  def latency(%Stream{} = stream, opts) do
    step = {:map, fn _data, message -> Situ.Message.latency(message) end}
    Operator.attach(stream, "Latency", step, Keyword.put_new(opts, :async, true), :integer)
  end

  def latency(other, _arg2), do: Argument.raise_invalid!(other, :stream, "Situ.latency(stream)")

  def delay(%Stream{} = stream, duration, opts) when is_integer(duration) and duration >= 0,
    do:
      Operator.attach_component(stream, "Delay", {Delay, [duration: duration]}, opts, stream.type)

  def delay(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.delay(stream, Situ.Time.ms(20))")

  def process(%Stream{} = stream, state, fun, opts) when is_function(fun, 2) do
    {own, placement} = Placement.split_options!(opts, @process, :operator)

    Operator.attach_component(
      stream,
      "Process",
      {Process, [state: state, fun: fun] ++ own},
      placement
    )
  end

  def process(other, _arg2, _arg3, _arg4),
    do:
      Argument.raise_invalid!(
        other,
        :stream,
        "Situ.process(stream, state, fn message, state -> {[], state} end)"
      )

  def edit(%Stream{} = stream, edits, opts) when is_list(edits) do
    edits = Generator.from_enumerable(stream.pipeline, Edit.sort_edits(edits), [])
    Operator.attach_component([in: stream, edits: edits], "Edit", {Edit, []}, opts, stream.type)
  end

  def edit(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.edit(stream, [{time, :delete}])")

  def reorder(%Stream{} = stream, lateness, opts)
      when is_integer(lateness) and lateness >= 0 do
    {own, placement} = Placement.split_options!(opts, @reorder, :operator)
    own = Keyword.put_new(own, :time, & &1.originating_time)

    Operator.attach_component(
      stream,
      "Reorder",
      {Reorder, [lateness: lateness] ++ own},
      placement,
      stream.type
    )
  end

  def reorder(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.reorder(stream, Situ.Time.ms(20))")
end
