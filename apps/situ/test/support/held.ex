defmodule Situ.Fixture.Held do
  # A source that waits for permission to start.
  use Situ.Component, outputs: [out: :any], options: [to: [type: :pid, required: true]]

  @impl true
  def init(opts), do: {:ok, opts[:to]}

  @impl true
  def handle_start(_context, to) do
    send(to, {:held, self()})
    receive do: (:go -> {[{:complete, :infinity}], to})
  end
end
