defmodule Situ.OpenTelemetry.Metrics do
  @moduledoc false
  # Reports the metrics of `Situ.Metrics` by observable instruments. One callback measures all of them, because a
  # snapshot of the pipelines contains them all. New names get an instrument when they appear.
  use GenServer
  require Logger

  # The API of metrics is an optional package.
  @compile {:no_warn_undefined, [:otel_meter, :opentelemetry_experimental]}
  # ms between searches for new metrics
  @interval 10_000

  def start_link(_opts), do: GenServer.start_link(__MODULE__, [])

  @impl true
  def init(_opts) do
    if Code.ensure_loaded?(:opentelemetry_experimental) do
      {:ok, add_instruments(MapSet.new())}
    else
      Logger.info("metrics are not reported, because opentelemetry_api_experimental is missing")
      :ignore
    end
  end

  @impl true
  def handle_info(:search, known), do: {:noreply, add_instruments(known)}

  defp add_instruments(known) do
    Process.send_after(self(), :search, @interval)
    metrics = measure()
    new = for {name, kind, help, _} <- metrics, name not in known, do: {name, kind, help}
    scope = :opentelemetry.get_application_scope(__MODULE__)
    meter = :opentelemetry_experimental.get_meter(scope)
    instruments = for metric <- new, do: create_instrument(meter, metric)
    names = Enum.map(new, &elem(&1, 0))

    if new != [],
      do: :otel_meter.register_callback(meter, instruments, &__MODULE__.observe/1, names)

    MapSet.union(known, MapSet.new(names))
  end

  defp create_instrument(meter, {name, kind, help}) do
    create = if kind == :counter, do: :create_observable_counter, else: :create_observable_gauge
    apply(:otel_meter, create, [meter, name, %{description: help, unit: unit(name)}])
  end

  @doc "Returns the observations of these instruments. The SDK's reader calls it."
  def observe(names) do
    for {name, _kind, _help, [_ | _] = samples} <- measure(), name in names, do: {name, samples}
  end

  # Names of instruments are atoms. They come from the modules that add metrics, so there are few.
  defp measure do
    for metric <- Situ.Metrics.collect(),
        {suffix, kind, samples} <- split(metric),
        do: {String.to_atom(metric.name <> suffix), kind, metric.help, samples}
  end

  defp split(%{type: type, samples: samples}) when type in [:counter, :gauge],
    do: [{"", type, for({labels, value} <- samples, do: {value, Map.new(labels)})}]

  defp split(%{samples: samples}) do
    pick = fn part -> for {labels, value, ^part} <- samples, do: {value, Map.new(labels)} end
    [{"_sum", :counter, pick.(:sum)}, {"_count", :counter, pick.(:count)}]
  end

  defp unit(name) do
    name = Atom.to_string(name)

    cond do
      name =~ "seconds" -> :s
      name =~ "bytes" -> :By
      true -> :"1"
    end
  end
end
