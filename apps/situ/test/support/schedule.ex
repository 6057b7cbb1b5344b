defmodule Situ.Fixture.Schedule do
  @moduledoc false
  # A source that emits batches with pauses between them, as a schedule says. Its times and values do not depend on
  # the schedule.
  use Situ.Component,
    outputs: [out: :any],
    options: [batches: [type: :list, required: true], last: [type: :any]]

  # A batch is `{spins, messages}`: `spins` is how often the process yields before it emits them.
  @impl true
  def init(opts), do: {:ok, opts[:batches]}

  @impl true
  def handle_start(context, []), do: {[{:close, :out, context.start_time}], []}

  def handle_start(_context, batches) do
    send(self(), :next)
    {[], batches}
  end

  @impl true
  def handle_info(:next, _context, [{spins, messages} | rest]) do
    for _ <- 1..spins//1, do: :erlang.yield()
    actions = for {time, data} <- messages, do: {:out, time, data}

    if rest == [] do
      {actions ++ [{:close, :out}], []}
    else
      send(self(), :next)
      {actions, rest}
    end
  end

  def handle_info(_other, _context, state), do: {[], state}

  # The source completes by closing, so it ignores stops.
  @impl true
  def handle_stop(_final, _context, state), do: {[], state}
end
