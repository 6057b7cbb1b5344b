defmodule Situ.Branch do
  @moduledoc """
  A piece of a pipeline that runs as a value: no process, no queue, one message at a time.

  Components are pure state machines, so a graph of them is one too. `Situ.parallel/3` runs its branches this way,
  which makes a branch as cheap as the state that its components keep.

      iex> branch = Situ.Branch.start(fn stream -> stream |> Situ.map(& &1 + 1) |> Situ.sum() end)
      iex> message = &%Situ.Message{originating_time: &1, data: &2}
      iex> {[{1, 11}], branch} = Situ.Branch.push(branch, message.(1, 10))
      iex> {outputs, _branch} = Situ.Branch.push(branch, message.(2, 20))
      iex> outputs
      [{2, 32}]

  A branch may hold anything that does no more than answer its inputs: all operators but sources, `Situ.timer/3` and
  `Situ.delay/3`, and components without timers and processes of their own. Others are refused with `Situ.Error`
  `:not_in_branch`.
  """

  alias Situ.{Error, Graph, Message, Stream}
  alias Situ.Branch.{Chained, Inlet, Network, Path}

  @type t :: Chained.t() | Network.t()
  @type outputs :: [{Situ.Time.t(), term()}]

  @typedoc "Where branches begin: a graph that holds the way in and nothing else."
  @opaque seed :: {Graph.t(), Stream.t()}

  @doc "The beginning that all branches with this type of input share."
  @spec seed(Situ.Type.t()) :: seed()
  def seed(type \\ :any) do
    Graph.build(fn p ->
      p
      |> Situ.Pipeline.add(Inlet, name: "In", outputs: [out: type])
      |> Situ.Node.output(:out)
    end)
  end

  @doc """
  Builds the graph of `fun` (from a stream to a stream, or to anything else when nothing is to come out) and starts it.

  Options: `type:` of the input or a `seed:`, `path:` for errors (a string, or `{string, key}`), `context:` the
  surrounding component's.
  """
  @spec start((Stream.t() -> Stream.t() | term()), keyword()) :: t()
  def start(fun, opts \\ []) when is_function(fun, 1) do
    {graph, inlet} = Keyword.get_lazy(opts, :seed, fn -> seed(opts[:type] || :any) end)
    {graph, result} = build(fun, graph, inlet)
    Enum.each(graph.vertices, &allowed!(&1, inlet.node))
    path = Keyword.get(opts, :path, "Branch")

    case Chained.plan(graph, inlet.node, result, path) do
      {:ok, chained} -> chained
      :error -> Network.start(graph, inlet.node, result, Path.to_string(path), opts[:context])
    end
  end

  defp build(fun, graph, inlet) do
    handle = Graph.Builder.open(graph)

    try do
      result = fun.(%{inlet | pipeline: handle})

      {Graph.Builder.peek(handle),
       if(is_struct(result, Stream), do: {result.node, result.output})}
    after
      Graph.Builder.close(handle)
    end
  end

  @doc "One message in; what comes out, in order."
  @spec push(t(), Message.t()) :: {outputs(), t()}
  def push(%Chained{} = branch, message), do: Chained.push(branch, message)
  def push(%Network{} = branch, message), do: Network.push(branch, message)

  @doc "The input ends: what still comes out."
  @spec close(t(), Situ.Time.t()) :: outputs()
  def close(%Chained{}, _time), do: []
  def close(%Network{} = branch, time), do: Network.close(branch, time)

  @doc "Whether an input's output, if it has one, comes with it and at its time."
  @spec immediate?(t()) :: boolean()
  def immediate?(%Chained{}), do: true
  def immediate?(%Network{}), do: false

  @doc "Whether something comes out at all."
  @spec output?(t()) :: boolean()
  def output?(%{result: result}), do: result != nil

  defp allowed!({inlet, _vertex}, inlet), do: :ok

  defp allowed!({_id, vertex}, _inlet) do
    if is_list(vertex.opts) and vertex.opts[:branches] == :processes do
      raise Error.new(
              :not_in_branch,
              "#{vertex.path} has branches in processes inside of a branch that is a value",
              fix: "give the outer parallel branches: :processes, too"
            )
    end

    if Graph.Vertex.source?(vertex) do
      raise Error.new(:not_in_branch, "#{vertex.path} is a source inside of a parallel branch",
              why: "a branch only reacts to its input",
              fix:
                "give parallel branches: :processes, or bring the source's values in with the messages"
            )
    end
  end
end
