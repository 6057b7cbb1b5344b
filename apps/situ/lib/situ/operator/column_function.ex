defmodule Situ.Operator.ColumnFunction do
  @moduledoc false
  # The component of `Situ.map/3` and `Situ.each/3` with `columns: true`. Like other operators, it emits messages with
  # new envelopes.
  use Situ.Component,
    share_process: true,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      fun: [type: {:fun, 1}, required: true],
      replace: [type: :boolean, default: true, doc: "Whether the function returns new values."]
    ]

  alias Situ.Columns

  @impl true
  def init(opts), do: {:ok, {opts[:fun], opts[:replace]}}

  @impl true
  def handle_message(:in, message, context, state),
    do:
      handle_columns(:in, Columns.new([message.originating_time], [message.data]), context, state)

  @impl true
  def handle_columns(:in, columns, _context, state),
    do: {[{:out, call_function(columns, state)}], state}

  defp call_function(columns, {fun, replace?}) do
    result = fun.(columns)
    if replace?, do: replace_values(columns, result), else: Columns.drop_envelopes(columns)
  end

  defp replace_values(columns, {kind, values}), do: Columns.put_values(columns, values, kind)

  defp replace_values(columns, %Columns{} = new),
    do: Columns.put_values(columns, new.values, new.kind)

  defp replace_values(columns, values), do: Columns.put_values(columns, values)
end
