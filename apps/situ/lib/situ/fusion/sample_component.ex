defmodule Situ.Fusion.SampleComponent do
  @moduledoc false
  # The component of sample and interpolate with a fixed interval.
  use Situ.Component,
    share_process: true,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      interpolator: [type: {:struct, Situ.Interpolator}, required: true],
      interval: [type: :pos_integer, required: true],
      align: [type: {:optional, :time_ns}]
    ]

  alias Situ.Sampling

  @impl true
  def init(opts), do: {:ok, {:idle, opts}}

  @impl true
  def handle_message(input, message, context, state),
    do: handle_messages(input, [message], context, state)

  # Ticks are counted from the pipeline's start. Older data (recorded data in a real-time pipeline) moves the first
  # tick.
  @impl true
  def handle_messages(:in, [first | _] = messages, context, {:idle, opts}) do
    start = min(context.start_time, first.originating_time)
    sampling = Sampling.new(opts[:interpolator], opts[:interval], start, opts[:align])
    handle_messages(:in, messages, context, sampling)
  end

  def handle_messages(:in, messages, _context, sampling),
    do: continue_ticks(Sampling.push(sampling, messages))

  @impl true
  def handle_info({:continue, :ticks}, _context, sampling),
    do: continue_ticks(Sampling.next_ticks(sampling))

  def handle_info(_other, _context, sampling), do: {[], sampling}

  @impl true
  # A source that never sent a message only has default values.
  def handle_closed(:in, time, context, {:idle, opts} = state) do
    case opts[:interpolator] do
      %{default: :none} ->
        {[], state}

      interpolator ->
        start = min(context.start_time, time)
        sampling = Sampling.new(interpolator, opts[:interval], start, opts[:align])
        continue_ticks(Sampling.close(sampling, time))
    end
  end

  def handle_closed(:in, time, _context, sampling),
    do: continue_ticks(Sampling.close(sampling, time))

  @impl true
  def reopen({:idle, opts}), do: {:idle, opts}
  def reopen(sampling), do: %{sampling | closed: nil}

  defp continue_ticks({outputs, sampling}) do
    if Sampling.more_ticks?(sampling),
      do: {outputs ++ [{:continue, :ticks}], sampling},
      else: {outputs, sampling}
  end
end
