defmodule Situ.Livebook do
  @moduledoc """
  Situ in Livebook notebooks. A cell that returns one of these values shows it:

  | value | shown as |
  |---|---|
  | a recording (`Situ.Store.open/1`) | the timeline of its streams |
  | `Situ.Image`, `Situ.EncodedImage`, `Situ.DepthImage` | a picture |
  | `Situ.AudioBuffer` | a player and the waveform |
  | `Situ.PointCloud` | the points, seen from above and the side |
  | `Situ.Message` | its time and its data |
  | a stream of a running pipeline (`Situ.Stream`) | a live plot, picture or value |
  | a pipeline's handle | its live graph |
  | a report (`Situ.Pipeline.run/2`) | the graph with its counts |

  `show/2` and `graph/2` do the same for a pipeline that is known by its pid or name. `run/2` runs a pipeline with
  buttons that start and stop it. Two smart cells write the code that opens a recording and that runs a pipeline.
  """
  alias Situ.Livebook.{GraphOutput, Runner, StreamOutput}

  @doc """
  Shows a stream of a running pipeline: numbers as a plot of the last seconds, images as a picture, all other values as
  text. A busy notebook shows fewer messages and does not slow the pipeline down.

  Options: `every:` is the minimum time between two drawings in ms (200), `seconds:` the time span of a plot (10).
  """
  @spec show(Situ.Subscription.target() | Situ.Stream.t(), keyword()) :: Kino.Frame.t()
  def show(stream, opts \\ [])

  def show(%Situ.Stream{name: name, pipeline: pipeline}, opts) when is_binary(name),
    do: show({pipeline, name}, opts)

  def show({_pipeline, _name} = target, opts),
    do: start_output(StreamOutput, {target, opts})

  @doc "Shows the graph of a running pipeline with the number of messages on each edge, every `every:` ms (1,000)."
  @spec graph(Situ.Pipeline.target(), keyword()) :: Kino.Frame.t()
  def graph(pipeline, opts \\ []),
    do: start_output(GraphOutput, {pipeline, opts[:every] || 1_000})

  defp start_output(module, arg) do
    frame = Kino.Frame.new()
    Kino.start_child!({module, {frame, arg}})
    frame
  end

  @doc """
  Shows buttons that start and stop a pipeline, with its live graph and the streams that `show:` names. The pipeline
  stops when its cell is evaluated again. `spec` and the other options are passed to `Situ.Pipeline.start/2`.

      Situ.Livebook.run(&Situ.sequence(&1, 1, fn n -> n + 1 end, every: Situ.Time.ms(100), name: "Count"),
        show: ["Count"]
      )
  """
  @spec run(module() | (Situ.Pipeline.t() -> term()), keyword()) :: Kino.Layout.t()
  def run(spec, opts \\ []) do
    {names, opts} = Keyword.pop(opts, :show, [])
    start = Kino.Control.button("Start")
    stop = Kino.Control.button("Stop")
    frame = Kino.Frame.new()
    Kino.start_child!({Runner, {spec, opts, names, {start, stop, frame}}})
    Kino.Layout.grid([Kino.Layout.grid([start, stop], columns: 8), frame])
  end

  @doc """
  Returns a graph as a Mermaid diagram.

      iex> {:ok, report} = Situ.Pipeline.run(fn p ->
      ...>   p |> Situ.from_enumerable(1..3, every: 1, name: "Numbers") |> Situ.each(& &1, name: "Sink")
      ...> end)
      iex> Situ.Livebook.to_mermaid(report.snapshot)
      ~s|graph LR\\n  n1["Numbers"]\\n  n2["Sink"]\\n  n1 -->\\|3\\| n2\\n|
  """
  @spec to_mermaid(Situ.Diagnostics.Snapshot.t()) :: String.t()
  def to_mermaid(snapshot) do
    nodes = for node <- snapshot.nodes, node.kind != :tap, do: node
    ids = MapSet.new(nodes, & &1.id)

    IO.iodata_to_binary([
      "graph LR\n",
      for(node <- nodes, do: ["  n#{node.id}", node_text(node), "\n"]),
      for(
        edge <- snapshot.edges,
        edge.from in ids and edge.to in ids,
        do: "  n#{edge.from} -->|#{edge_text(edge)}| n#{edge.to}\n"
      )
    ])
  end

  # Characters outside of names could end the text of a node.
  defp node_text(node) do
    failed = if node.errors > 0, do: " (#{node.errors} errors)", else: ""
    [~s(["), String.replace(node.path, ~r/[^\p{L}\p{N} ._-]/u, " "), failed, ~s("])]
  end

  defp edge_text(%{dropped: 0} = edge), do: "#{edge.processed}"
  defp edge_text(edge), do: "#{edge.processed}, #{edge.dropped} dropped"
end
