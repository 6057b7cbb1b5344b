defmodule Situ.Branch do
  @moduledoc false
  # A part of a pipeline that runs as a value: it has no process and no queue, and handles one message at a time.
  # Components are pure state machines, and so is a graph of them. `Situ.parallel/3` runs its branches this way, so a
  # branch costs no more than the state of its components. Components with a clock or a process are rejected with
  # `Situ.Error` `:not_in_branch`.
  alias Situ.{Error, Graph, Message, Stream}
  alias Situ.Branch.{Chain, Input, Network}
  alias Situ.Component.Snapshot

  @type t :: Chain.t() | Network.t()
  @type outputs :: [{Situ.Time.t(), term()}]

  @typedoc "The name of a branch. It is only formatted for errors, because branches are many and errors are rare."
  @type path :: String.t() | {String.t(), key :: term()}

  @typedoc "The start of a branch: a graph that contains only its inlet."
  @opaque seed :: {Graph.t(), Stream.t()}

  @typedoc "The graph of a branch, and the branch when it had just started."
  @opaque template :: {{Graph.t(), term()}, t()} | nil

  @doc "Builds the initial graph shared by all branches with this input type."
  @spec build_seed(Situ.Type.t()) :: seed()
  def build_seed(type \\ :any) do
    Graph.build(fn p ->
      p
      |> Situ.Pipeline.add(Input, name: "In", outputs: [out: type])
      |> Situ.Node.output(:out)
    end)
  end

  @doc "Formats the name of a branch."
  @spec format_path(path()) :: String.t()
  def format_path({path, key}), do: "#{path}[#{inspect(key, limit: 5, printable_limit: 40)}]"
  def format_path(path), do: path

  @doc """
  Builds the graph of `fun` and starts it. `fun` maps a stream to a stream, or to any other term if the branch has no
  output.

  Options: `type:` (of the input) or `seed:`, `path:` for errors, and `context:` (of the surrounding component).
  """
  @spec start((Stream.t() -> Stream.t() | term()), keyword()) :: t()
  def start(fun, opts \\ []) when is_function(fun, 1), do: fun |> start_like(nil, opts) |> elem(0)

  @doc """
  Does the same as `start/2`, but shares the memory of a branch that was built before if `fun` builds the same chain of
  light operators again. Also returns the template for the next branch.
  """
  @spec start_like((Stream.t() -> Stream.t() | term()), template(), keyword()) ::
          {t(), template()}
  def start_like(fun, template, opts) do
    {graph, inlet} = Keyword.get_lazy(opts, :seed, fn -> build_seed(opts[:type] || :any) end)
    built = build_graph(fun, graph, inlet)

    case template do
      {^built, branch} -> {branch, template}
      _ -> start_graph(built, inlet, template, opts)
    end
  end

  defp start_graph({graph, result} = built, inlet, template, opts) do
    Enum.each(graph.vertices, &check_vertex!(&1, inlet.node))

    case Chain.from_graph(graph, inlet.node, result) do
      {:ok, chain} ->
        {chain, {built, chain}}

      :error ->
        path = opts |> Keyword.get(:path, "Branch") |> format_path()
        {Network.from_graph(graph, inlet.node, result, path, opts[:context]), template}
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
  def push(%Chain{} = branch, %{originating_time: time} = message) do
    case Chain.push_data(branch, message.data, message) do
      {:value, data, branch} -> {[{time, data}], branch}
      {:value, data} -> {[{time, data}], branch}
      {:skip, branch} -> {[], branch}
      :skip -> {[], branch}
    end
  end

  def push(%Network{} = branch, message), do: Network.push(branch, message)

  @doc "Closes the input and returns the remaining outputs."
  @spec close(t(), Situ.Time.t()) :: outputs()
  def close(%Chain{}, _time), do: []
  def close(%Network{} = branch, time), do: Network.close(branch, time)

  @doc "Returns whether the branch has an output."
  @spec has_output?(t()) :: boolean()
  def has_output?(%Chain{shape: shape}), do: shape.output?
  def has_output?(%Network{result: result}), do: result != nil

  @doc "Returns the state of the branch at `path` as plain data, for a checkpoint."
  @spec take_snapshot(t(), String.t()) :: {:ok, term()} | {:error, Error.t()}
  def take_snapshot(%Chain{steps: steps}, path), do: Snapshot.to_plain_data(steps, path)
  def take_snapshot(%Network{} = branch, _path), do: Network.take_snapshot(branch)

  @doc "Restores the state of a branch that has just started."
  @spec restore_snapshot(t(), term(), String.t()) :: {:ok, t()} | {:error, Error.t()}
  def restore_snapshot(%Chain{} = branch, plain, path) do
    with {:ok, steps} <- Snapshot.fill_functions(plain, branch.steps, path),
         do: {:ok, %{branch | steps: steps}}
  end

  def restore_snapshot(%Network{} = branch, plain, _path),
    do: Network.restore_snapshot(branch, plain)

  defp check_vertex!({inlet, _vertex}, inlet), do: :ok

  defp check_vertex!({_id, vertex}, _inlet) do
    if vertex.module == Situ.Parallel.Component and vertex.opts[:strategy] != Situ.Parallel.Values do
      raise Error.new(
              :not_in_branch,
              "#{vertex.path} has branches with processes inside a branch that runs as a value",
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
