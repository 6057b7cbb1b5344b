defmodule Situ.Pipeline.Dynamic.Replacement do
  @moduledoc false
  # Replaces the module or the options of a running component. Each stage handles one replacement at a time, in the
  # order of the requests. A waiting request is checked against the component at the time when it begins.
  alias Situ.{Error, Runtime, Type}
  alias Situ.Component.FunctionSwap
  alias Situ.Graph.{Edge, Vertex}
  alias Situ.Lifecycle.Errors
  alias Situ.Pipeline.{Stages, State}

  @doc "Asks the stage or queues the request; the caller receives its reply when the replacement succeeds or fails."
  @spec request_replacement(State.t(), map(), GenServer.from()) :: State.t()
  def request_replacement(state, %{node: node, change: change, timeout: timeout}, from) do
    with {:ok, vertex} <- State.fetch_vertex(state, node),
         {:ok, stage, _index} <- State.fetch_stage(state, vertex.id) do
      ref = make_ref()
      if timeout != :infinity, do: Runtime.send_after({:situ_late, ref, timeout}, timeout)
      enqueue_request(state, stage.id, %{ref: ref, vertex: vertex.id, change: change, from: from})
    else
      {:error, error} ->
        GenServer.reply(from, {:error, error})
        state
    end
  end

  @doc """
  Replaces each operator with the operator of the same name in `graph`, another version of the same pipeline, and the
  functions in component options with the functions at the same positions. `from` receives one reply from each running
  component that has new functions; returns their number.
  """
  @spec reload(State.t(), Situ.Graph.t(), GenServer.from()) :: {State.t(), non_neg_integer()}
  def reload(state, graph, from) do
    fresh =
      for {_, vertex} <- graph.vertices, into: %{}, do: {{vertex.path, vertex.module}, vertex}

    Enum.reduce(state.graph.vertices, {state, 0}, fn {id, vertex}, {state, count} ->
      with %{opts: new} <- fresh[{vertex.path, vertex.module}],
           renewed when renewed != vertex.opts <- renew_options(vertex, new) do
        # A restart begins with the new functions, even if the stage ends before it has taken them.
        state = put_options(state, id, renewed)
        request = %{ref: make_ref(), vertex: id, change: {:renew, vertex.module, new}, from: from}
        renew_stage(state, request, count)
      else
        _ -> {state, count}
      end
    end)
  end

  defp renew_stage(state, request, count) do
    case State.fetch_stage(state, request.vertex) do
      {:ok, stage, _index} -> {enqueue_request(state, stage.id, request), count + 1}
      {:error, _error} -> {state, count}
    end
  end

  defp renew_options(%{module: :operator}, new), do: new

  defp renew_options(%{opts: old}, new),
    do: FunctionSwap.replace_functions(old, FunctionSwap.pair_functions(old, new))

  defp put_options(state, id, opts) do
    change = &if(&1.id == id, do: %{&1 | opts: opts}, else: &1)

    stages =
      Map.new(state.stages, fn {key, stage} ->
        {key, %{stage | vertices: Enum.map(stage.vertices, change)}}
      end)

    vertices = Map.update!(state.graph.vertices, id, change)
    %{state | graph: %{state.graph | vertices: vertices}, stages: stages}
  end

  defp enqueue_request(%{dynamic: %{replaces: replaces}} = state, id, request) do
    case replaces do
      %{^id => {current, waiting}} -> put_entry(state, id, {current, :queue.in(request, waiting)})
      _ -> begin_request(state, id, request, :queue.new())
    end
  end

  defp begin_request(state, id, request, waiting) do
    vertex = state.graph.vertices[request.vertex]

    with {:ok, stage, index} <- State.fetch_stage(state, vertex.id),
         {:ok, module, opts} <- resolve_target(vertex, request.change),
         :ok <- check_ports(state.graph, vertex, module) do
      Stages.send_request(state, stage.id, {:replace, request.ref, index, module, opts})
      opts = with {:keep, step} <- opts, do: step

      put_entry(
        state,
        id,
        {Map.merge(request, %{index: index, module: module, opts: opts}), waiting}
      )
    else
      {:error, error} ->
        reply_to_caller(request, {:error, error})
        begin_next(state, id, waiting)
    end
  end

  defp begin_next(state, id, waiting) do
    case :queue.out(waiting) do
      {{:value, request}, waiting} -> begin_request(state, id, request, waiting)
      {:empty, _} -> put_entry(state, id, nil)
    end
  end

  @doc "Handles the stage's reply."
  @spec handle_reply(State.t(), pos_integer(), reference(), :ok | {:error, Error.t()}) ::
          State.t()
  def handle_reply(state, id, ref, answer) do
    case state.dynamic.replaces do
      %{^id => {%{ref: ^ref} = request, waiting}} ->
        reply_to_caller(request, answer)
        state = if answer == :ok, do: update_stage_vertex(state, id, request), else: state
        begin_next(state, id, waiting)

      _ ->
        state
    end
  end

  @doc "Replies to the caller with a timeout error; the replacement itself continues."
  @spec handle_timeout(State.t(), reference(), timeout()) :: State.t()
  def handle_timeout(state, ref, timeout) do
    error = {:error, Errors.request_timeout(:replace, timeout)}

    replaces =
      Map.new(state.dynamic.replaces, fn {id, {current, waiting}} ->
        waiting =
          :queue.from_list(Enum.map(:queue.to_list(waiting), &reply_if_ref(&1, ref, error)))

        {id, {reply_if_ref(current, ref, error), waiting}}
      end)

    %{state | dynamic: %{state.dynamic | replaces: replaces}}
  end

  defp reply_if_ref(%{ref: ref} = request, ref, error) do
    reply_to_caller(request, error)
    %{request | from: nil}
  end

  defp reply_if_ref(request, _ref, _error), do: request

  @doc "Fails the requests of callers that wait for a stage whose process has ended."
  @spec fail_pending(State.t(), pos_integer()) :: State.t()
  def fail_pending(state, id) do
    case state.dynamic.replaces do
      %{^id => {current, waiting}} ->
        path = state.graph.vertices[current.vertex].path

        for request <- [current | :queue.to_list(waiting)],
            do: reply_to_caller(request, {:error, Errors.component_restarted(path)})

        put_entry(state, id, nil)

      _ ->
        state
    end
  end

  defp reply_to_caller(%{from: nil}, _answer), do: :ok
  defp reply_to_caller(%{from: from}, answer), do: GenServer.reply(from, answer)

  defp put_entry(state, id, nil),
    do: %{state | dynamic: %{state.dynamic | replaces: Map.delete(state.dynamic.replaces, id)}}

  defp put_entry(state, id, entry),
    do: %{
      state
      | dynamic: %{state.dynamic | replaces: Map.put(state.dynamic.replaces, id, entry)}
    }

  # A restart begins with this component and these options from now on.
  defp update_stage_vertex(state, id, %{index: index, module: module, opts: opts}) do
    stage = Map.fetch!(state.stages, id)
    vertices = List.update_at(stage.vertices, index, &%{&1 | module: module, opts: opts})
    vertex = Enum.at(vertices, index)
    graph = %{state.graph | vertices: Map.put(state.graph.vertices, vertex.id, vertex)}
    %{state | graph: graph, stages: Map.put(state.stages, id, %{stage | vertices: vertices})}
  end

  # The new component

  # A new version of the same function keeps the current state. A component that was replaced in the meantime has no
  # function of the pipeline's module.
  defp resolve_target(%Vertex{module: same} = vertex, {:renew, same, new}) do
    with {:ok, _module, _opts} <- resolve_target(vertex, new),
         do: {:ok, same, {:keep, renew_options(vertex, new)}}
  end

  defp resolve_target(vertex, {:renew, _other, _new}), do: {:error, other_kind_error(vertex)}

  defp resolve_target(%Vertex{module: :operator} = vertex, {kind, fun} = step)
       when is_function(fun) do
    if kind == elem(vertex.opts, 0),
      do: {:ok, :operator, step},
      else: {:error, other_kind_error(vertex)}
  end

  defp resolve_target(%Vertex{module: :operator} = vertex, {:step, _fun, _state} = step),
    do:
      if(elem(vertex.opts, 0) == :step,
        do: {:ok, :operator, step},
        else: {:error, other_kind_error(vertex)}
      )

  defp resolve_target(%Vertex{module: :operator} = vertex, _),
    do: {:error, other_kind_error(vertex)}

  defp resolve_target(_vertex, {module, opts}) when is_atom(module) and is_list(opts) do
    if Code.ensure_loaded?(module) and function_exported?(module, :handle_message, 4),
      do: {:ok, module, opts},
      else: {:error, Error.new(:not_a_component, "#{inspect(module)} is not a component")}
  end

  defp resolve_target(vertex, opts) when is_list(opts), do: {:ok, vertex.module, opts}

  defp resolve_target(_vertex, other),
    do:
      {:error,
       Error.new(:bad_replacement, "expected {module, opts} or options, got: #{inspect(other)}")}

  defp other_kind_error(vertex) do
    Error.new(
      :bad_replacement,
      "#{vertex.path} is an operator of kind #{inspect(elem(vertex.opts, 0))}",
      fix: "replace it with a step of the same kind; see Situ.Operator"
    )
  end

  defp check_ports(_graph, %Vertex{module: same}, same), do: :ok

  defp check_ports(graph, vertex, module) do
    with :ok <- check_inputs(graph, vertex, module.inputs()),
         do: check_outputs(graph, vertex, module.outputs())
  end

  defp check_inputs(graph, vertex, inputs) do
    Enum.find_value(Map.values(graph.edges), :ok, fn %Edge{from: {from, output}, to: {to, input}} ->
      type = graph.vertices[from].outputs[output].type

      if to == vertex.id and not port_accepts?(inputs[input], type),
        do: {:error, type_mismatch_error(vertex, name_port(:input, input), inputs[input], type)}
    end)
  end

  defp check_outputs(graph, vertex, outputs) do
    Enum.find_value(Map.values(graph.edges), :ok, fn %Edge{from: {from, output}, to: {to, input}} ->
      type = graph.vertices[to].inputs[input].type

      if from == vertex.id and
           (outputs[output] == nil or not Type.accepts?(type, port_type(outputs[output]))),
         do:
           {:error,
            type_mismatch_error(vertex, name_port(:output, output), type, outputs[output])}
    end)
  end

  defp port_accepts?(nil, _type), do: false
  defp port_accepts?(port, type), do: Type.accepts?(port_type(port), type)

  defp port_type({type, opts}) when is_list(opts) and (opts == [] or is_tuple(hd(opts))), do: type
  defp port_type(type), do: type

  defp name_port(kind, name), do: "#{kind} #{inspect(name)}"

  defp type_mismatch_error(vertex, port, expected, actual) do
    Error.new(:type_mismatch, "#{vertex.path} cannot be replaced: #{port} does not fit",
      why:
        "the port is connected: #{describe_port(actual)} flows where #{describe_port(expected)} is declared",
      meta: %{component: vertex.path}
    )
  end

  defp describe_port(nil), do: "nothing"
  defp describe_port(port), do: port |> port_type() |> Type.to_string()
end
