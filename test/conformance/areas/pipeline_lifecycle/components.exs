# Components that emit scripted messages and report their callbacks.

defmodule Situ.Conformance.PipelineLifecycle.Source do
  # Emits scripted messages at scripted times.
  use Situ.Component, outputs: [out: :any], options: [kind: [type: :any], tell: [type: :any]]

  @impl true
  def handle_start(context, opts), do: {start(opts[:kind], context), opts}

  @impl true
  def handle_info({:timer, actions}, _context, opts), do: {actions, opts}

  defp start(:finite, context),
    do: [{:out, context.start_time, 0}, {:complete, context.start_time}]

  defp start(:infinite, _context), do: [{:complete, :infinity}]
  defp start(:raises, context), do: [{:out, context.start_time, div(1, context.start_time * 0)}]
  defp start(:silent, _context), do: []

  defp start(:becomes_infinite, context),
    do: [{:timer, [{:complete, :infinity}], context.start_time + 50_000_000}]

  defp start({:messages, messages}, _context) do
    {last, _} = List.last(messages)
    for({time, v} <- messages, do: {:out, time, v}) ++ [{:complete, last}]
  end

  defp start({:later, delay}, context),
    do: [{:out, context.start_time + delay, 0}, {:complete, :infinity}]
end

defmodule Situ.Conformance.PipelineLifecycle.Watch do
  # Reports its start and the clock that it uses.
  use Situ.Component, outputs: [out: :any], options: [tell: [type: :any, required: true]]

  @impl true
  def handle_start(context, opts) do
    opts[:tell].(
      {context.start_time, Situ.Pipeline.Client.call!(context.pipeline, :timing).clock}
    )

    {[{:complete, context.start_time}], opts}
  end
end

defmodule Situ.Conformance.PipelineLifecycle.Ticker do
  # An infinite timer: 1, 2, 3 ...
  use Situ.Component, outputs: [out: :integer], options: [interval: [type: :pos_integer]]

  @impl true
  def init(opts), do: {:ok, {opts[:interval], 0}}

  @impl true
  def handle_start(context, state),
    do: {[{:complete, :infinity}, next(context.start_time, state)], state}

  @impl true
  def handle_info({:timer, time}, _context, {interval, n}),
    do: {[{:out, time, n + 1}, next(time, {interval, n})], {interval, n + 1}}

  defp next(time, {interval, _}), do: {:timer, time + interval, time + interval}
end

defmodule Situ.Conformance.PipelineLifecycle.Relay do
  # Relays x to any and x, y to any and y, z to any and z. Each output has its own increasing
  # times.
  use Situ.Component,
    inputs: [x: {:any, optional: true}, y: {:any, optional: true}, z: {:any, optional: true}],
    outputs: [any: :any, x: :any, y: :any, z: :any, gen: :any],
    options: [
      tell: [type: :any, required: true],
      gen: [type: :any, default: false],
      at_close: [type: :any]
    ]

  @tick 100

  @impl true
  def init(opts),
    do: {:ok, %{tell: opts[:tell], last: %{}, at_close: opts[:at_close], gen: opts[:gen]}}

  @impl true
  def handle_start(context, %{gen: true} = state) do
    times = for n <- 1..3, do: context.start_time + n * 1_000_000
    {Enum.map(times, &{:gen, &1, 0}) ++ [{:complete, List.last(times)}], state}
  end

  def handle_start(_context, %{gen: :endless} = state), do: {[{:complete, :infinity}], state}
  def handle_start(_context, state), do: {[], state}

  @impl true
  def handle_message(input, message, context, state) do
    state.tell.({:received, context.path, input})
    {any, state} = later(state, :any, message)
    {same, state} = later(state, input, message)
    {[{:any, any, message.data}, {input, same, message.data}], state}
  end

  @impl true
  def handle_closed(input, _time, context, state) do
    state.tell.({:closed, context.path, input})
    if state.at_close, do: Situ.Pipeline.stop(context.pipeline)
    {[], state}
  end

  defp later(state, output, message) do
    time =
      max(Map.get(state.last, output, message.originating_time), message.originating_time) +
        @tick

    {time, put_in(state.last[output], time)}
  end
end

defmodule Situ.Conformance.PipelineLifecycle.Generator do
  # A relay that is also a source, so that the end of its generation ends the pipeline.
  use Situ.Component,
    inputs: [x: {:any, optional: true}, y: {:any, optional: true}, z: {:any, optional: true}],
    outputs: [any: :any, x: :any, y: :any, z: :any, gen: :any],
    options: [
      tell: [type: :any, required: true],
      gen: [type: :any, default: true],
      at_close: [type: :any]
    ]

  @impl true
  defdelegate init(opts), to: Situ.Conformance.PipelineLifecycle.Relay
  @impl true
  defdelegate handle_start(context, state), to: Situ.Conformance.PipelineLifecycle.Relay
  @impl true
  defdelegate handle_message(input, message, context, state),
    to: Situ.Conformance.PipelineLifecycle.Relay

  @impl true
  defdelegate handle_closed(input, time, context, state),
    to: Situ.Conformance.PipelineLifecycle.Relay

  @impl true
  def handle_demand(_n, _context, state), do: {[], state}
end

defmodule Situ.Conformance.PipelineLifecycle.Probe do
  # Reports every callback.
  use Situ.Component,
    inputs: [in: {:any, optional: true}],
    outputs: [out: :any],
    options: [tell: [type: :any], posts: [type: :boolean, default: true]]

  @impl true
  def handle_start(context, opts) do
    opts[:tell].({:start, context.path})
    {[{:out, context.start_time, 1}, {:complete, context.start_time}], opts}
  end

  @impl true
  def handle_demand(_n, _context, opts), do: {[], opts}

  @impl true
  def handle_message(:in, _message, context, opts) do
    opts[:tell].({:delivery, context.path})
    {[], opts}
  end

  @impl true
  def handle_stop(_final, context, opts) do
    opts[:tell].({:stop, context.path})
    {[], opts}
  end
end

defmodule Situ.Conformance.PipelineLifecycle.Collecting do
  # Keeps its messages and posts them when its input has closed, each after a pause.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [pause: [type: :non_neg_integer, default: 0]]

  @impl true
  def init(opts), do: {:ok, {opts[:pause], []}}

  @impl true
  def handle_message(:in, message, _context, {pause, kept}), do: {[], {pause, [message | kept]}}

  @impl true
  def handle_closed(:in, _time, _context, {pause, kept}) do
    posts =
      for message <- Enum.reverse(kept) do
        Process.sleep(pause)
        {:out, message.originating_time, message.data}
      end

    {posts, {pause, []}}
  end
end
