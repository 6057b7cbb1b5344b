defmodule Situ.Diagnostics.Source do
  @moduledoc false
  # The Diagnostics stream emits a snapshot every interval of the pipeline's clock, and a last one when it stops.
  use Situ.Component,
    outputs: [out: Situ.Diagnostics.Snapshot],
    options: [
      interval: [type: :pos_integer, default: 100_000_000, doc: "Time between snapshots, ns."]
    ]

  @impl true
  def init(opts), do: {:ok, {opts[:interval], nil}}

  @impl true
  def handle_start(context, {interval, _} = state),
    do: {[{:complete, :infinity}, {:timer, :tick, context.start_time + interval}], state}

  # The last snapshot may have a time that the clock has not reached yet, so later ticks must not emit.
  @impl true
  def handle_info({:timer, :tick}, %{now: now}, {_, last} = state)
      when last != nil and now <= last,
      do: {[], state}

  def handle_info({:timer, :tick}, context, {interval, _}) do
    now = context.now
    {[snapshot_action(context, now), {:timer, :tick, now + interval}], {interval, now}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  # The last snapshot gets the end time of the pipeline, regardless of when it is taken.
  @impl true
  def handle_stop(final, context, {interval, last}) when last == nil or final > last,
    do: {[snapshot_action(context, final)], {interval, final}}

  def handle_stop(_final, _context, state), do: {[], state}

  defp snapshot_action(context, time),
    do: {:out, time, GenServer.call(context.pipeline.pid, :info, :infinity)}
end
