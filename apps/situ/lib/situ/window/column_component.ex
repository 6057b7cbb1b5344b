defmodule Situ.Window.ColumnComponent do
  @moduledoc false
  # The component of windows with `with: :columns`.
  use Situ.Component,
    share_process: true,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [window: [type: :any, required: true], fun: [type: {:fun, 1}, required: true]]

  alias Situ.Columns
  alias Situ.Window.ByColumns

  @impl true
  def init(opts), do: {:ok, ByColumns.new(opts[:window], opts[:fun])}

  @impl true
  def handle_message(:in, message, _context, core),
    do: ByColumns.push(core, Columns.new([message.originating_time], [message.data]))

  @impl true
  def handle_columns(:in, columns, _context, core), do: ByColumns.push(core, columns)
end
