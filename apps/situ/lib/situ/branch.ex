defmodule Situ.Branch do
  @moduledoc false
  # A part of a pipeline that runs as a value: it has no process and no queue, and handles one message at a time.
  # Components are pure state machines, and so is a graph of them. `Situ.parallel/3` runs its branches this way, so a
  # branch costs no more than the state of its components. Components with a clock or a process are rejected with
  # `Situ.Error` `:not_in_branch`.
  alias Situ.{Error, Graph, Message, Stream}
  alias Situ.Branch.{Chain, Input, Network, Path}

  @type t :: Chain.t() | Network.t()
  @type outputs :: [{Situ.Time.t(), term()}]

  @typedoc "The start of a branch: a graph that contains only its inlet."
  @opaque seed :: {Graph.t(), Stream.t()}

  @doc "Builds the initial graph shared by all branches with this input type."
  @spec build_seed(Situ.Type.t()) :: seed()
  def build_seed(type \\ :any) do
    Graph.build(fn p ->
      p
      |> Situ.Pipeline.add(Input, name: "In", outputs: [out: type])
      |> Situ.Node.output(:out)
    end)
  end

  @doc """
  Builds the graph of `fun` and starts it. `fun` maps a stream to a stream, or to any other term if the branch has no
  output.

  Options: `type:` (of the input) or `seed:`, `path:` for errors (a string, or `{string, key}`), and `context:` (of
  the surrounding component).
  """
  @spec start((Stream.t() -> Stream.t() | term()), keyword()) :: t()
  def start(fun, opts \\ []) when is_function(fun, 1) do
    {graph, inlet} = Keyword.get_lazy(opts, :seed, fn -> build_seed(opts[:type] || :any) end)
    {graph, result} = build_graph(fun, graph, inlet)
    Enum.each(graph.vertices, &check_vertex!(&1, inlet.node))
    path = Keyword.get(opts, :path, "Branch")

    case Chain.from_graph(graph, inlet.node, result, path) do
      {:ok, chain} ->
        chain

      :error ->
        Network.from_graph(graph, inlet.node, result, Path.to_string(path), opts[:context])
    end
  end

  defp build_graph(fun, graph, inlet) do
    handle = Graph.Builder.open_graph(graph)

    try do
      result = fun.(%{inlet | pipeline: handle})

      {Graph.Builder.current_graph(handle),
       if(is_struct(result, Stream), do: {result.node, result.output})}
    after
      Graph.Builder.close_graph(handle)
    end
  end

  @doc """
  Pushes a message through the branch and returns its outputs in order.

      iex> branch = Situ.Branch.start(fn stream -> stream |> Situ.map(& &1 + 1) |> Situ.sum() end)
      iex> message = &%Situ.Message{originating_time: &1, data: &2}
      iex> {[{1, 11}], branch} = Situ.Branch.push(branch, message.(1, 10))
      iex> {outputs, _branch} = Situ.Branch.push(branch, message.(2, 20))
      iex> outputs
      [{2, 32}]
  """
  @spec push(t(), Message.t()) :: {outputs(), t()}
  def push(%Chain{} = branch, message), do: Chain.push(branch, message)
  def push(%Network{} = branch, message), do: Network.push(branch, message)

  @doc "Closes the input and returns the remaining outputs."
  @spec close(t(), Situ.Time.t()) :: outputs()
  def close(%Chain{}, _time), do: []
  def close(%Network{} = branch, time), do: Network.close(branch, time)

  @doc "Returns whether each input's output, if any, is emitted immediately and at the same originating time."
  @spec immediate_output?(t()) :: boolean()
  def immediate_output?(%Chain{}), do: true
  def immediate_output?(%Network{}), do: false

  @doc "Returns whether the branch has an output."
  @spec has_output?(t()) :: boolean()
  def has_output?(%{result: result}), do: result != nil

  defp check_vertex!({inlet, _vertex}, inlet), do: :ok

  defp check_vertex!({_id, vertex}, _inlet) do
    if is_list(vertex.opts) and vertex.opts[:branches] == :processes do
      raise Error.new(
              :not_in_branch,
              "#{vertex.path} uses branches: :processes inside a branch that runs as a value",
              fix: "give the outer parallel operator branches: :processes, too"
            )
    end

    if Graph.Vertex.source?(vertex) do
      raise Error.new(:not_in_branch, "#{vertex.path} is a source inside a parallel branch",
              why: "a branch only reacts to its input",
              fix:
                "give parallel branches: :processes, or bring in the source's values with the messages"
            )
    end
  end
end
