defmodule Situ.OpenTelemetry.LogFilter do
  @moduledoc false
  # Adds the ids of spans to log events of pipelines, as a primary filter of the logger. The process only removes the
  # filter when it ends.
  use GenServer
  alias OpenTelemetry.Span
  alias Situ.OpenTelemetry.Spans

  def start_link(_opts), do: GenServer.start_link(__MODULE__, [])

  @impl true
  def init(_opts) do
    Process.flag(:trap_exit, true)
    _ = :logger.remove_primary_filter(__MODULE__)
    :ok = :logger.add_primary_filter(__MODULE__, {&__MODULE__.add_ids/2, nil})
    {:ok, nil}
  end

  @impl true
  def terminate(_reason, _state), do: :logger.remove_primary_filter(__MODULE__)

  def add_ids(%{meta: %{pipeline: pipeline} = meta} = event, _extra)
      when not is_map_key(meta, :otel_trace_id) do
    case Spans.find(pipeline, meta[:component]) do
      :undefined -> :ignore
      span -> %{event | meta: Map.merge(meta, Span.hex_span_ctx(span))}
    end
  end

  def add_ids(_event, _extra), do: :ignore
end
