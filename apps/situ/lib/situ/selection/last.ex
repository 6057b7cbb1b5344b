defmodule Situ.Selection.Last do
  @moduledoc false
  # Keeps the last messages until the stream ends.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [count: [type: :non_neg_integer, required: true]]

  # Messages are newest first, and truncated to `count` only when twice as many have accumulated.
  @impl true
  def init(opts), do: {:ok, {opts[:count], 0, []}}

  @impl true
  def handle_message(_input, message, _context, {count, length, messages}) do
    if length + 1 > 2 * count,
      do: {[], {count, count, Enum.take([message | messages], count)}},
      else: {[], {count, length + 1, [message | messages]}}
  end

  @impl true
  def handle_closed(_input, _time, _context, {count, _kept, messages}) do
    last = messages |> Enum.take(count) |> Enum.reverse()
    {Enum.map(last, &{:out, &1.originating_time, &1.data}), {count, 0, []}}
  end
end
