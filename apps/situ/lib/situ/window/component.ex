defmodule Situ.Window.Component do
  @moduledoc false
  # The component of windows that look ahead (by index or time) and of windows from a stream.
  use Situ.Component,
    share_process: true,
    inputs: [],
    outputs: [out: :any],
    options: [core: [type: :any, required: true, doc: "`{module, function, arguments}`"]]

  alias Situ.Window.{ByIndex, ByStream, ByTime}

  @impl true
  def init(opts) do
    {module, function, arguments} = opts[:core]
    {:ok, apply(module, function, arguments)}
  end

  @impl true
  def handle_message(input, message, context, core),
    do: handle_messages(input, [message], context, core)

  @impl true
  def handle_messages(:in, messages, _context, %ByIndex{} = core),
    do: ByIndex.push(core, messages)

  def handle_messages(:in, messages, _context, %ByTime{} = core),
    do: ByTime.push(core, messages)

  def handle_messages(:in, messages, _context, %ByStream{} = core),
    do: ByStream.push_source(core, messages)

  def handle_messages(:windows, messages, _context, core),
    do: ByStream.push_windows(core, messages)

  @impl true
  def handle_closed(:in, _time, _context, %ByTime{} = core), do: ByTime.close(core)
  def handle_closed(:in, _time, _context, %ByStream{} = core), do: ByStream.close_source(core)
  def handle_closed(_input, _time, _context, core), do: {[], core}

  @impl true
  def reopen(%ByStream{} = core), do: %{core | reached: nil}
  def reopen(core), do: core
end
