defmodule Situ.OpenTelemetry.MessageTracer do
  @moduledoc false
  # Makes a trace of some messages of a stream. A tap notices that a message has arrived; the route through the pipeline
  # is read from its counters afterwards.
  use GenServer
  require Logger
  require OpenTelemetry.Tracer, as: Tracer
  alias OpenTelemetry.{Ctx, Span}

  @tap "OpenTelemetry"
  # ms between attempts to find the pipeline
  @retry 1_000
  # The last component needs some time for a message that has just left the tapped one.
  @settle 50

  def start_link(args), do: GenServer.start_link(__MODULE__, args)

  @impl true
  def init(args) do
    send(self(), :attach)
    {:ok, Map.merge(args, %{monitor: nil, next: nil})}
  end

  @impl true
  def handle_info(:attach, state) do
    me = self()

    tap =
      Situ.attach_tap({state.pipeline, state.stream}, &send(me, {:message, &1.originating_time}),
        policy: Situ.Delivery.latest(),
        name: @tap
      )

    case tap do
      {:ok, tap} ->
        {:noreply, %{state | monitor: Process.monitor(tap.pipeline)}}

      {:error, error} ->
        # A pipeline that is not running may start later. All other errors need the user.
        if error.code != :not_running, do: Logger.warning(Exception.message(error))
        Process.send_after(self(), :attach, @retry)
        {:noreply, state}
    end
  end

  def handle_info({:message, time}, %{next: next} = state) do
    now = System.monotonic_time(:millisecond)

    if next == nil or now >= next do
      Process.send_after(self(), {:trace, time}, @settle)
      {:noreply, %{state | next: now + state.every}}
    else
      {:noreply, state}
    end
  end

  def handle_info({:trace, time}, state) do
    trace = Situ.trace(state.pipeline, time)
    report(state, time, Enum.filter(trace.hops, &passed?/1))
    {:noreply, state}
  rescue
    # The pipeline has ended.
    Situ.Error -> {:noreply, state}
  end

  def handle_info({:DOWN, ref, :process, _pid, _reason}, %{monitor: ref} = state) do
    Process.send_after(self(), :attach, @retry)
    {:noreply, %{state | monitor: nil}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp passed?(hop),
    do: hop.state == :passed and hop.to != @tap and is_integer(hop.sent) and is_integer(hop.taken)

  defp report(_state, _time, []), do: :ok

  defp report(state, time, hops) do
    links =
      case Situ.OpenTelemetry.span(state.pipeline) do
        :undefined -> []
        span -> [OpenTelemetry.link(span)]
      end

    attributes = %{"situ.pipeline" => state.pipeline, "situ.stream" => state.stream}
    options = %{attributes: attributes, start_time: timestamp(time), links: links}
    span = Tracer.start_span(Ctx.new(), "message #{state.stream}", options)
    ctx = Tracer.set_current_span(Ctx.new(), span)

    for hop <- hops do
      options = %{start_time: timestamp(hop.sent), attributes: %{"situ.queue" => hop.queue}}
      child = Tracer.start_span(ctx, "#{hop.from} to #{hop.to}", options)
      Span.end_span(child, timestamp(hop.taken))
    end

    Span.end_span(span, hops |> Enum.map(& &1.taken) |> Enum.max() |> timestamp())
  end

  # Timestamps of OpenTelemetry are native monotonic times.
  defp timestamp(ns),
    do: System.convert_time_unit(ns, :nanosecond, :native) - System.time_offset(:native)
end
