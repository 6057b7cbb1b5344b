defmodule Situ.Pipeline.Place do
  @moduledoc false
  # Where a stream of a running pipeline is to be had: which vertex and output, in which stage, and how far down its chain.
  alias Situ.{Error, Graph, Options}
  alias Situ.Pipeline.{Launch, Life}

  @type port_id :: {pos_integer(), atom()}

  @doc "Vertex and output of a stream, given as that or by its name."
  @spec port(Life.t(), port_id() | String.t()) :: {:ok, port_id()} | {:error, Error.t()}
  def port(state, {id, output}) do
    if Map.has_key?(state.graph.vertices, id),
      do: {:ok, {id, output}},
      else: {:error, Launch.not_running()}
  end

  def port(state, name) do
    named = Graph.stream_names(state.graph)

    case named do
      %{^name => port} -> {:ok, port}
      _ -> {:error, unknown(name, Map.keys(named))}
    end
  end

  @doc "The running stage that a vertex is in, and its index there."
  @spec stage(Life.t(), pos_integer()) ::
          {:ok, map(), non_neg_integer()} | {:error, Error.t()}
  def stage(state, id) do
    found =
      Enum.find_value(state.stages, fn {_, stage} ->
        index = Enum.find_index(stage.vertices, &(&1.id == id))
        index && stage.state == :running && {stage, index}
      end)

    case found do
      {stage, index} -> {:ok, stage, index}
      _ -> {:error, Launch.not_running()}
    end
  end

  @doc "The stage whose output the vertex' is, if it is not inside of a chain."
  @spec outlet(Life.t(), pos_integer()) :: {:ok, map()} | {:error, Error.t()}
  def outlet(state, id) do
    with {:ok, stage, index} <- stage(state, id) do
      if index == length(stage.vertices) - 1,
        do: {:ok, stage},
        else: {:error, inside(state.graph.vertices[id].path)}
    end
  end

  defp unknown(name, known) do
    near = Options.nearest(name, known)

    fix =
      if near, do: "did you mean #{inspect(near)}?", else: "streams: " <> Enum.join(known, ", ")

    Error.new(:unknown_stream, "the pipeline has no stream #{inspect(name)}", fix: fix)
  end

  defp inside(path) do
    Error.new(
      :inside_chain,
      "#{path} runs inside a chain of operators and has no output of its own",
      fix: "give it a process of its own with async: true, or look at it with Situ.tap/3"
    )
  end
end
