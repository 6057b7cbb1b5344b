defmodule Situ.Graph do
  @moduledoc false
  # The graph of a pipeline as plain data: vertices in order of construction, edges, names and replay proposals. All
  # functions here are pure. `Situ.Graph.Builder` holds the graph during construction. `build/1` builds a graph
  # without a pipeline process, for components that run their own graphs.
  alias Situ.{Delivery, Error, Options, Type}
  alias Situ.Graph.{Edge, Placement, StreamNames, Vertex}

  defstruct vertices: %{},
            edges: %{},
            connected: %{},
            paths: %{},
            numbers: %{},
            stream_names: %{},
            scopes: %{},
            proposals: [],
            handlers: [],
            resources: %{},
            next_vertex: 1,
            next_edge: 1,
            next_source: 1,
            default_policy: nil,
            replay: {:unbounded, :unbounded}

  @type t :: %__MODULE__{
          vertices: %{pos_integer() => Vertex.t()},
          edges: %{pos_integer() => Edge.t()},
          connected: %{{pos_integer(), atom()} => pos_integer()},
          paths: %{String.t() => pos_integer()},
          numbers: %{String.t() => pos_integer()},
          stream_names: %{String.t() => {pos_integer(), atom()}},
          scopes: %{String.t() => %{policy: Delivery.t() | nil, unit: tuple() | nil}},
          proposals: [{Situ.Time.t(), Situ.Time.t() | :unbounded}],
          handlers: [{atom(), fun()}],
          resources: %{fun() => term()},
          next_vertex: pos_integer(),
          next_edge: pos_integer(),
          next_source: pos_integer(),
          default_policy: Delivery.t() | nil,
          replay: {Situ.Time.t() | :unbounded, Situ.Time.t() | :unbounded}
        }

  @doc """
  Runs `fun` with the handle of a new graph that only this process holds; returns the graph and the function's result.

      iex> {graph, node} = Situ.Graph.build(fn p -> Situ.Pipeline.add(p, Situ.Component.Empty, name: "A") end)
      iex> {node.path, Map.keys(graph.vertices)}
      {"A", [1]}
  """
  @spec build((Situ.Graph.Handle.t() -> result)) :: {t(), result} when result: term()
  def build(fun) when is_function(fun, 1), do: Situ.Graph.Builder.build_graph(fun)

  @doc "Adds a component with its own options and the options of `Situ.Graph.Placement`. Raises `Situ.Error`."
  @spec add_component(t(), Situ.Graph.Handle.t(), module(), keyword()) :: {Situ.Node.t(), t()}
  def add_component(%__MODULE__{} = graph, handle, module, opts) do
    check_module!(module)
    {opts, placement} = Placement.split_options!(opts, module.options(), :component)

    vertex = %Vertex{
      id: graph.next_vertex,
      module: module,
      opts: opts,
      inputs: build_ports(placement[:inputs] || module.inputs()),
      outputs: [],
      policy: placement[:policy],
      on_error: placement[:on_error],
      async: placement[:async],
      check: placement[:check],
      on_same_time: placement[:on_same_time],
      scope: handle.scope
    }

    name = placement[:name] || placement[:default_name] || default_name(module)

    insert_vertex(
      graph,
      handle,
      vertex,
      placement[:outputs] || module.outputs(),
      name,
      placement[:name]
    )
  end

  @doc "Adds a light operator that consumes `stream`; see `Situ.Operator.attach/5`."
  @spec add_operator(t(), Situ.Stream.t(), map()) :: {Situ.Node.t(), t()}
  def add_operator(%__MODULE__{} = graph, stream, spec) do
    opts = spec.opts

    vertex = %Vertex{
      id: graph.next_vertex,
      module: :operator,
      opts: spec.step,
      inputs: [in: %{type: spec.in_type, optional: false}],
      outputs: [],
      on_error: opts[:on_error],
      async: opts[:async],
      check: :first,
      scope: stream.pipeline.scope
    }

    name = opts[:name] || opts[:default_name] || spec.name

    {node, graph} =
      insert_vertex(graph, stream.pipeline, vertex, [out: spec.out_type], name, opts[:name])

    {:ok, graph} = connect(graph, stream, node, :in, policy: opts[:policy])
    {node, graph}
  end

  @doc "Connects a stream to a node's input. Raises `Situ.Error` if the port, the type or the pipeline does not match."
  @spec connect(t(), Situ.Stream.t(), Situ.Node.t(), atom(), keyword()) :: {:ok, t()}
  def connect(%__MODULE__{} = graph, stream, node, input, opts \\ []) do
    opts = Options.validate!(opts, policy: [type: {:optional, {:struct, Delivery}}])
    check_same!(stream, node)
    from = Map.fetch!(graph.vertices, stream.node)
    to = Map.fetch!(graph.vertices, node.id)
    port = Keyword.get(to.inputs, input) || raise unknown_port(:input, node, input)
    check_free!(graph, to, input)
    check_types!(from, stream, to, input, port.type)
    policy = opts[:policy] || to.policy

    edge = %Edge{
      id: graph.next_edge,
      from: {from.id, stream.output},
      to: {to.id, input},
      policy:
        policy || surrounding_scope(graph, to.scope).policy || graph.default_policy ||
          Delivery.unlimited(),
      explicit: policy != nil
    }

    connected = Map.put(graph.connected, edge.to, edge.id)
    edges = Map.put(graph.edges, edge.id, edge)
    {:ok, %{graph | edges: edges, connected: connected, next_edge: edge.id + 1}}
  end

  @doc "Names a stream. Raises `Situ.Error` if the name is already in use."
  @spec name_stream(t(), Situ.Stream.t(), String.t()) :: {:ok, t()}
  def name_stream(%__MODULE__{} = graph, stream, name) do
    port = {stream.node, stream.output}

    case graph.stream_names do
      %{^name => other} when other != port -> raise duplicate_name_error("stream", name)
      names -> {:ok, %{graph | stream_names: Map.put(names, name, port)}}
    end
  end

  @scope [
    policy: [
      type: {:optional, {:struct, Delivery}},
      doc:
        "Default policy of the connections inside. Without it, the policy of the surrounding composite or pipeline."
    ],
    on_error: [
      type: {:in, [:stop, :restart, :close]},
      default: :stop,
      doc:
        "If a component inside fails and would end the pipeline: end the pipeline, restart the whole composite, " <>
          "or close the whole composite (as `stop_part/3` does)."
    ]
  ]

  @doc false
  def scope_schema, do: @scope

  @doc "Opens the scope `name` within `scope`, with a unique path. Its options apply to the components inside."
  @spec open_scope(t(), String.t() | nil, String.t(), keyword()) :: {String.t(), t()}
  def open_scope(%__MODULE__{} = graph, scope, name, opts \\ []) do
    opts = Options.validate!(opts, @scope)
    path = join_path(scope, name)
    if path_taken?(graph, path), do: raise(duplicate_name_error("component", path))
    outer = surrounding_scope(graph, scope)
    unit = if opts[:on_error] == :stop, do: outer.unit, else: {path, opts[:on_error]}
    inner = %{policy: opts[:policy] || outer.policy, unit: unit}
    {path, %{graph | scopes: Map.put(graph.scopes, path, inner)}}
  end

  defp surrounding_scope(graph, scope),
    do: Map.get(graph.scopes, scope, %{policy: nil, unit: nil})

  @doc "Returns the stream with this name. Raises `Situ.Error` if there is none."
  @spec fetch_stream!(t(), Situ.Graph.Handle.t(), String.t()) :: Situ.Stream.t()
  def fetch_stream!(%__MODULE__{} = graph, handle, name) do
    named = StreamNames.map_names(graph)

    case named do
      %{^name => {id, output}} ->
        type = graph.vertices[id].outputs[output].type
        %Situ.Stream{pipeline: handle, node: id, output: output, name: name, type: type}

      _ ->
        raise unknown_stream(name, Map.keys(named))
    end
  end

  @doc "Returns the error for a stream that does not exist, with the nearest name."
  @spec unknown_stream(term(), [String.t()]) :: Error.t()
  def unknown_stream(name, known) do
    near = is_binary(name) && Options.nearest_name(name, known)

    fix =
      if near, do: "did you mean #{inspect(near)}?", else: "streams: " <> Enum.join(known, ", ")

    Error.new(:unknown_stream, "the pipeline has no stream #{inspect(name)}", fix: fix)
  end

  @doc "Returns the error for a port that does not exist, with the nearest name."
  @spec unknown_port(:input | :output, Situ.Node.t(), atom()) :: Error.t()
  def unknown_port(kind, node, name) do
    known = Keyword.keys(if kind == :input, do: node.inputs, else: node.outputs)
    near = known != [] && Options.nearest_name(name, known)
    hint = if near, do: "did you mean #{inspect(near)}? ", else: ""
    code = if kind == :input, do: :unknown_input, else: :unknown_output

    Error.new(code, "#{node.path} has no #{kind} #{inspect(name)}",
      fix: hint <> "It has: " <> Enum.map_join(known, ", ", &inspect/1)
    )
  end

  defp insert_vertex(graph, handle, vertex, outputs, name, explicit) do
    {path, graph} = unique_path(graph, join_path(handle.scope, name), explicit)

    {outputs, next_source} =
      Enum.map_reduce(build_ports(outputs), graph.next_source, fn {port, info}, id ->
        {{port, Map.put(info, :source_id, id)}, id + 1}
      end)

    unit = surrounding_scope(graph, vertex.scope).unit
    vertex = %{vertex | path: path, outputs: outputs, unit: unit, named?: explicit != nil}

    graph = %{
      graph
      | vertices: Map.put(graph.vertices, vertex.id, vertex),
        paths: Map.put(graph.paths, path, vertex.id),
        next_vertex: vertex.id + 1,
        next_source: next_source
    }

    {build_node(handle, vertex), graph}
  end

  defp build_node(handle, vertex) do
    %Situ.Node{
      pipeline: handle,
      id: vertex.id,
      path: vertex.path,
      module: vertex.module,
      inputs: port_types(vertex.inputs),
      outputs: port_types(vertex.outputs)
    }
  end

  defp port_types(ports), do: Enum.map(ports, fn {name, port} -> {name, port.type} end)

  defp build_ports(list) do
    Enum.map(list, fn
      # Match only this form, because `{:tuple, [optional: type]}` is a type.
      {name, {type, [optional: optional]}} when is_boolean(optional) ->
        {name, %{type: validate_type!(type), optional: optional}}

      {name, type} ->
        {name, %{type: validate_type!(type), optional: false}}
    end)
    |> unique_ports!()
  end

  defp validate_type!(type) do
    if Type.valid_type?(type),
      do: type,
      else: raise(ArgumentError, "not a port type: #{inspect(type)}; see Situ.Type")
  end

  defp unique_ports!(ports) do
    case Keyword.keys(ports) -- Enum.uniq(Keyword.keys(ports)) do
      [] -> ports
      [name | _] -> raise Error.new(:duplicate_port, "two ports named #{inspect(name)}")
    end
  end

  defp unique_path(graph, path, nil) do
    if path_taken?(graph, path),
      do: number_path(graph, path, Map.get(graph.numbers, path, 2)),
      else: {path, graph}
  end

  defp unique_path(graph, path, _explicit) do
    if path_taken?(graph, path),
      do: raise(duplicate_name_error("component", path)),
      else: {path, graph}
  end

  # Finds the smallest free number. Numbers below the last one found are known to be in use.
  defp number_path(graph, path, n) do
    name = path <> Integer.to_string(n)

    if path_taken?(graph, name),
      do: number_path(graph, path, n + 1),
      else: {name, %{graph | numbers: Map.put(graph.numbers, path, n + 1)}}
  end

  defp path_taken?(graph, path),
    do: Map.has_key?(graph.paths, path) or Map.has_key?(graph.scopes, path)

  defp join_path(nil, name), do: name
  defp join_path(scope, name), do: scope <> "." <> name

  defp default_name(module), do: module |> Module.split() |> List.last()

  defp check_module!(module) do
    unless is_atom(module) and Code.ensure_loaded?(module) and
             function_exported?(module, :handle_message, 4) do
      raise Error.new(:not_a_component, "#{inspect(module)} is not a component",
              fix: "use Situ.Component in it, and check its name"
            )
    end
  end

  defp check_same!(stream, node) do
    if stream.pipeline.ref != node.pipeline.ref do
      raise Error.new(
              :different_pipeline,
              "stream #{inspect(stream.name)} and #{node.path} belong to different pipelines",
              fix: "send the stream to the other pipeline with Situ.Connector"
            )
    end
  end

  defp check_free!(graph, to, input) do
    case Map.get(graph.connected, {to.id, input}) do
      nil ->
        :ok

      id ->
        other = Map.fetch!(graph.vertices, elem(graph.edges[id].from, 0))

        raise Error.new(
                :already_connected,
                "input #{to.path}.#{input} is already connected to #{other.path}",
                why: "an input accepts only one stream",
                fix: "merge the streams first (Situ.merge/2)"
              )
    end
  end

  defp check_types!(from, stream, to, input, type) do
    unless Type.accepts?(type, stream.type) do
      raise Error.new(
              :type_mismatch,
              "#{from.path}.#{stream.output} emits #{Type.to_string(stream.type)}, " <>
                "but #{to.path}.#{input} takes #{Type.to_string(type)}",
              fix: "convert the data with Situ.map/3, or correct the declared type"
            )
    end
  end

  defp duplicate_name_error(kind, name) do
    Error.new(:duplicate_name, "there is already a #{kind} named #{inspect(name)}",
      fix: "choose a different name:"
    )
  end
end
