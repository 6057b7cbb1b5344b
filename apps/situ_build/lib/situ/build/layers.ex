defmodule Situ.Build.Layers do
  @moduledoc false
  # The layers of the runtime: a module may only name modules of the same layer and of lower
  # layers.
  #
  # A namespace belongs to one layer. `Situ` itself is the top layer. `Situ.Application`, which
  # starts the processes that the layers need, and `Situ.Test` may name all layers.
  #
  # | layer | holds |
  # |---|---|
  # | `runtime` | how processes start and wait, and how timers are set: by the VM, or by a simulation |
  # | `clock` | clocks, and the choice of a pipeline's clock, start and end |
  # | `graph` | the graph of components as data: vertices, edges, plans, policies, the behaviours of components |
  # | `ports` | inputs and outputs of a running component: queues, demand, posting rules, counters |
  # | `stage` | the process of one component or chain: its time slices, timers, errors |
  # | `lifecycle` | the life cycle of a pipeline as a pure state machine |
  # | `diagnostics` | the state of a pipeline for observers: snapshots, means, tables |
  # | `application` | state shared by all pipelines of a node: the registry, last results, the reaper, code upgrades |
  # | `pipeline` | the process of one pipeline, which executes the decisions of the life cycle |
  # | `connectors` | ways into and out of a running pipeline: collectors, taps, connectors, GenStage, metrics |
  # | `operators` | stream functions: fusion, windows, statistics, generators, parallel branches |
  # | `situ.ex` | the facade |
  alias Situ.Build.Beam

  # Names, not modules: the build tool must not depend on the apps that it checks.
  @layers [
    runtime: ~w(Situ.Runtime),
    clock: ~w(Situ.Clock),
    graph:
      ~w(Situ.Argument Situ.Component Situ.Delivery Situ.Graph Situ.Node Situ.Operator Situ.Stream),
    ports: ~w(Situ.Ports),
    stage: ~w(Situ.Stage),
    lifecycle: ~w(Situ.Lifecycle),
    diagnostics: ~w(Situ.Diagnostics),
    application:
      ~w(Situ.Application.CodeReload Situ.Application.Directory Situ.Application.PipelineResults
      Situ.Application.Reaper Situ.Application.Tables),
    pipeline: ~w(Situ.Pipeline),
    connectors:
      ~w(Situ.Collector Situ.Connector Situ.GenStage Situ.Metrics Situ.Subscription Situ.Tap),
    operators:
      ~w(Situ.Aggregate Situ.Available Situ.Branch Situ.Filter Situ.Fusion Situ.Generator Situ.Indexer
      Situ.Interpolator Situ.MapAsync Situ.Parallel Situ.Reproducible Situ.Sampling Situ.Selection
      Situ.StateMachine Situ.Statistics Situ.Window),
    "situ.ex": ~w(Situ)
  ]
  @names Keyword.keys(@layers)
  @by_namespace for {{_name, namespaces}, index} <- Enum.with_index(@layers),
                    namespace <- namespaces,
                    into: %{},
                    do: {namespace, index}

  @doc """
  Returns the index of the layer that a module belongs to, from 0, or `:any` if it is in no layer.

      iex> Situ.Build.Layers.layer_index(:"Elixir.Situ.Graph.Edge")
      2
      iex> Situ.Build.Layers.layer_index(:"Elixir.Situ")
      11
      iex> Situ.Build.Layers.layer_index(:"Elixir.Situ.Test")
      :any
  """
  @spec layer_index(module()) :: non_neg_integer() | :any
  def layer_index(module), do: module |> inspect() |> find_namespace()

  # The longest namespace decides.
  defp find_namespace(name) when is_map_key(@by_namespace, name), do: @by_namespace[name]

  defp find_namespace(name) do
    case name |> String.split(".") |> Enum.drop(-1) do
      [_, _ | _] = outer -> outer |> Enum.join(".") |> find_namespace()
      _outermost -> :any
    end
  end

  @doc "Returns the names of the layers, lowest first, with the number of modules in each."
  @spec count_modules([Beam.t()]) :: [{String.t(), non_neg_integer()}]
  def count_modules(beams) do
    by_layer = Enum.frequencies_by(beams, &layer_index(&1.module))
    for {name, n} <- Enum.with_index(@names), do: {"#{name}", Map.get(by_layer, n, 0)}
  end

  @doc "Returns one sentence for each reference from a module to a module of a higher layer."
  @spec find_violations([Beam.t()]) :: [String.t()]
  def find_violations(beams) do
    layers =
      for beam <- beams, n = layer_index(beam.module), n != :any, into: %{}, do: {beam.module, n}

    for %{module: module, names: names} <- beams,
        own = layers[module],
        named <- names,
        its = layers[named],
        its > own do
      "layer #{layer_name(own)} must not use layer #{layer_name(its)}: #{inspect(module)} names #{inspect(named)}"
    end
    |> Enum.sort()
  end

  defp layer_name(n), do: Enum.at(@names, n)
end
