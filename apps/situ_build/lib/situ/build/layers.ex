defmodule Situ.Build.Layers do
  @moduledoc """
  The layers inside the runtime: a module may name those of its own layer and of the layers below it.

  The folder of a module's source file is its layer; `situ.ex` is the topmost. `application.ex`, which starts what the
  layers need, and `testing/` may name all.

  | layer | holds |
  |---|---|
  | `clock` | clocks, and by which one a pipeline runs, from when to when |
  | `graph` | the graph of components as data: vertices, edges, plans, policies, the behaviours of components |
  | `ports` | inputs and outputs of a running component: queues, demand, posting rules, counters |
  | `stage` | the process of one component or chain: its turns, timers, errors |
  | `lifecycle` | the life of a pipeline as a pure state machine |
  | `diagnostics` | what a pipeline looks like from outside: snapshots, means, tables |
  | `application` | what all pipelines of a node share: who runs, last results, the reaper, new versions of modules |
  | `pipeline` | the process of one pipeline: performs what the life cycle decides |
  | `connectors` | ways into and out of a running pipeline: collectors, taps, connectors, GenStage |
  | `operators` | stream functions: fusion, windows, statistics, generators, parallel branches |
  | `situ.ex` | the facade |
  """
  alias Situ.Build.Beam

  @app "apps/situ/lib/situ"
  @order ~w(clock graph ports stage lifecycle diagnostics application pipeline connectors operators)

  @doc """
  The number of the layer that a source file belongs to, from 0; `:any` where the file stands outside the layers.

      iex> Situ.Build.Layers.layer("/x/apps/situ/lib/situ/graph/graph.ex")
      1
      iex> Situ.Build.Layers.layer("/x/apps/situ/lib/situ.ex")
      10
      iex> Situ.Build.Layers.layer("/x/apps/situ/lib/situ/testing/test.ex")
      :any
  """
  @spec layer(Path.t()) :: non_neg_integer() | :any
  def layer(source) do
    case source |> String.split(@app) |> List.last() |> Path.split() do
      ["/", folder | _] -> Enum.find_index(@order, &(&1 == folder)) || :any
      [".ex"] -> length(@order)
      _ -> :any
    end
  end

  @doc "The names of the layers from below, with the number of modules in each."
  @spec counts([Beam.t()]) :: [{String.t(), non_neg_integer()}]
  def counts(beams) do
    by_layer = Enum.frequencies_by(beams, &layer(&1.source))
    for {name, n} <- Enum.with_index(@order ++ ["situ.ex"]), do: {name, Map.get(by_layer, n, 0)}
  end

  @doc "One sentence for every module that names one of a higher layer."
  @spec violations([Beam.t()]) :: [String.t()]
  def violations(beams) do
    layers = for beam <- beams, n = layer(beam.source), n != :any, into: %{}, do: {beam.module, n}

    for %{module: module, names: names} <- beams,
        own = layers[module],
        named <- names,
        its = layers[named],
        its > own do
      "layer #{name(own)} must not use layer #{name(its)}: #{inspect(module)} names #{inspect(named)}"
    end
    |> Enum.sort()
  end

  defp name(n), do: Enum.at(@order ++ ["situ.ex"], n)
end
