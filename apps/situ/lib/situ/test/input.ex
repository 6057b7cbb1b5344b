defmodule Situ.Test.Input do
  @moduledoc false
  # A push source that emits the messages that the test feeds it.
  use Situ.Component,
    inputs: [],
    outputs: [out: :any],
    options: [to: [type: :pid], ref: [type: :any], key: [type: :any]]

  @impl true
  def init(opts), do: {:ok, opts}

  @impl true
  def handle_start(_context, opts) do
    send(opts[:to], {:situ_test_input, opts[:ref], opts[:key], self()})
    {[], opts}
  end

  @impl true
  def handle_info({:situ_feed, messages}, _context, opts) do
    {for({time, data} <- messages, do: {:out, time, data}), opts}
  end

  def handle_info({:situ_close, nil}, _context, opts), do: {[{:close, :out}], opts}
  def handle_info({:situ_close, time}, _context, opts), do: {[{:close, :out, time}], opts}
  def handle_info(_other, _context, opts), do: {[], opts}
end
