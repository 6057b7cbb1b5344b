defmodule Situ.Fusion.Merger do
  @moduledoc false
  # The component behind merge: whole messages in the order of arrival, stamped with the clock.
  use Situ.Component, inputs: [], outputs: [out: Situ.Message]

  @impl true
  def init(_opts), do: {:ok, nil}

  @impl true
  def handle_message(_input, message, context, last) do
    time = if last == nil, do: context.now, else: max(context.now, last + 1)
    {[{:out, time, message}], time}
  end
end
