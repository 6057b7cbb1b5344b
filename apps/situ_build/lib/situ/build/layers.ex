defmodule Situ.Build.Layers do
  @moduledoc """
  The layers of the runtime: a module may only name modules of the same layer and of lower layers.

  The folder of a module's source file is its layer; `situ.ex` is the top layer. `application.ex`, which starts the
  processes that the layers need, and `testing/` may name all layers.

  | layer | holds |
  |---|---|
  | `clock` | clocks, and the choice of a pipeline's clock, start and end |
  | `graph` | the graph of components as data: vertices, edges, plans, policies, the behaviours of components |
  | `ports` | inputs and outputs of a running component: queues, demand, posting rules, counters |
  | `stage` | the process of one component or chain: its time slices, timers, errors |
  | `lifecycle` | the life cycle of a pipeline as a pure state machine |
  | `diagnostics` | the state of a pipeline for observers: snapshots, means, tables |
  | `application` | state shared by all pipelines of a node: the registry, last results, the reaper, code upgrades |
  | `pipeline` | the process of one pipeline, which executes the decisions of the life cycle |
  | `connectors` | ways into and out of a running pipeline: collectors, taps, connectors, GenStage |
  | `operators` | stream functions: fusion, windows, statistics, generators, parallel branches |
  | `situ.ex` | the facade |
  """
  alias Situ.Build.Beam

  @app "apps/situ/lib/situ"
  @order ~w(clock graph ports stage lifecycle diagnostics application pipeline connectors operators)

  @doc """
  Returns the index of the layer that a source file belongs to, from 0, or `:any` if the file is in no layer.

      iex> Situ.Build.Layers.layer_index("/x/apps/situ/lib/situ/graph/graph.ex")
      1
      iex> Situ.Build.Layers.layer_index("/x/apps/situ/lib/situ.ex")
      10
      iex> Situ.Build.Layers.layer_index("/x/apps/situ/lib/situ/testing/test.ex")
      :any
  """
  @spec layer_index(Path.t()) :: non_neg_integer() | :any
  def layer_index(source) do
    case source |> String.split(@app) |> List.last() |> Path.split() do
      ["/", folder | _] -> Enum.find_index(@order, &(&1 == folder)) || :any
      [".ex"] -> length(@order)
      _ -> :any
    end
  end

  @doc "Returns the names of the layers, lowest first, with the number of modules in each."
  @spec count_modules([Beam.t()]) :: [{String.t(), non_neg_integer()}]
  def count_modules(beams) do
    by_layer = Enum.frequencies_by(beams, &layer_index(&1.source))
    for {name, n} <- Enum.with_index(@order ++ ["situ.ex"]), do: {name, Map.get(by_layer, n, 0)}
  end

  @doc "Returns one sentence for each reference from a module to a module of a higher layer."
  @spec find_violations([Beam.t()]) :: [String.t()]
  def find_violations(beams) do
    layers =
      for beam <- beams, n = layer_index(beam.source), n != :any, into: %{}, do: {beam.module, n}

    for %{module: module, names: names} <- beams,
        own = layers[module],
        named <- names,
        its = layers[named],
        its > own do
      "layer #{layer_name(own)} must not use layer #{layer_name(its)}: #{inspect(module)} names #{inspect(named)}"
    end
    |> Enum.sort()
  end

  defp layer_name(n), do: Enum.at(@order ++ ["situ.ex"], n)
end
