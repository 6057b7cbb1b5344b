defmodule Situ.Connector.Once do
  @moduledoc false
  # Emits one message at the start; used by the example of `Situ.Connector`.
  use Situ.Component, outputs: [out: :any], options: [data: [type: :any, required: true]]

  @impl true
  def handle_start(context, opts),
    do: {[{:out, context.start_time, opts[:data]}, {:complete, context.start_time}], opts}
end
