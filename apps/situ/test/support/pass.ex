defmodule Situ.Fixture.Pass do
  # Forwards every message, as a component rather than an operator.
  use Situ.Component, inputs: [in: :any], outputs: [out: :any]

  @impl true
  def handle_message(:in, message, _context, state),
    do: {[{:out, message.originating_time, message.data}], state}
end

defmodule Situ.Fixture.Closing do
  # Reports when its input closes.
  use Situ.Component, inputs: [in: :any], options: [to: [type: :pid, required: true]]

  @impl true
  def init(opts), do: {:ok, opts[:to]}

  @impl true
  def handle_message(:in, _message, _context, to), do: {[], to}

  @impl true
  def handle_closed(input, time, _context, to) do
    send(to, {:closed, input, time})
    {[], to}
  end
end
