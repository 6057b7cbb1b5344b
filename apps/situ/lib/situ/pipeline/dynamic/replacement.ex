defmodule Situ.Pipeline.Dynamic.Replacement do
  @moduledoc false
  # Replaces the module or the options of a running component. Each stage handles one replacement at a time, in the
  # order of the requests. A waiting request is checked against the component at the time when it begins.
  alias Situ.{Error, Type}
  alias Situ.Component.Functions
  alias Situ.Graph.{Edge, Vertex}
  alias Situ.Lifecycle.Errors
  alias Situ.Pipeline.State

  @doc "Asks the stage or queues the request; the caller receives its reply when the replacement succeeds or fails."
  @spec ask(State.t(), map(), GenServer.from()) :: State.t()
  def ask(state, %{node: node, change: change, timeout: timeout}, from) do
    with {:ok, vertex} <- State.vertex(state, node),
         {:ok, stage, _index} <- State.stage(state, vertex.id) do
      ref = make_ref()
      if timeout != :infinity, do: Process.send_after(self(), {:situ_late, ref, timeout}, timeout)
      enter(state, stage.id, %{ref: ref, vertex: vertex.id, change: change, from: from})
    else
      {:error, error} ->
        GenServer.reply(from, {:error, error})
        state
    end
  end

  @doc """
  Replaces each operator with the operator of the same name in `graph`, another version of the same pipeline, and the
  functions in component options with the functions at the same positions.
  """
  @spec reload(State.t(), Situ.Graph.t()) :: State.t()
  def reload(state, graph) do
    fresh =
      for {_, vertex} <- graph.vertices, into: %{}, do: {{vertex.path, vertex.module}, vertex}

    Enum.reduce(state.graph.vertices, state, fn {id, vertex}, state ->
      with %{opts: new} <- fresh[{vertex.path, vertex.module}],
           renewed when renewed != vertex.opts <- renewed(vertex, new),
           {:ok, stage, _index} <- State.stage(state, id) do
        enter(state, stage.id, %{ref: make_ref(), vertex: id, change: {:keep, renewed}, from: nil})
      else
        _ -> state
      end
    end)
  end

  defp renewed(%{module: :operator}, new), do: new
  defp renewed(%{opts: old}, new), do: Functions.exchange(old, Functions.pairs(old, new))

  defp enter(%{dynamic: %{replaces: replaces}} = state, id, request) do
    case replaces do
      %{^id => {current, waiting}} -> put(state, id, {current, :queue.in(request, waiting)})
      _ -> begin(state, id, request, :queue.new())
    end
  end

  defp begin(state, id, request, waiting) do
    vertex = state.graph.vertices[request.vertex]

    with {:ok, stage, index} <- State.stage(state, vertex.id),
         {:ok, module, opts} <- target(vertex, request.change),
         :ok <- fits(state.graph, vertex, module) do
      send(stage.pid, {:situ, {:replace, request.ref, index, module, opts}})
      opts = with {:keep, step} <- opts, do: step
      put(state, id, {Map.merge(request, %{index: index, module: module, opts: opts}), waiting})
    else
      {:error, error} ->
        reply(request, {:error, error})
        next(state, id, waiting)
    end
  end

  defp next(state, id, waiting) do
    case :queue.out(waiting) do
      {{:value, request}, waiting} -> begin(state, id, request, waiting)
      {:empty, _} -> put(state, id, nil)
    end
  end

  @doc "Handles the stage's reply."
  @spec answered(State.t(), pos_integer(), reference(), :ok | {:error, Error.t()}) :: State.t()
  def answered(state, id, ref, answer) do
    case state.dynamic.replaces do
      %{^id => {%{ref: ^ref} = request, waiting}} ->
        reply(request, answer)
        state = if answer == :ok, do: replaced(state, id, request), else: state
        next(state, id, waiting)

      _ ->
        state
    end
  end

  @doc "Replies to the caller with a timeout error; the replacement itself continues."
  @spec late(State.t(), reference(), timeout()) :: State.t()
  def late(state, ref, timeout) do
    error = {:error, Errors.timeout(:replace, timeout)}

    replaces =
      Map.new(state.dynamic.replaces, fn {id, {current, waiting}} ->
        waiting = :queue.from_list(Enum.map(:queue.to_list(waiting), &told(&1, ref, error)))
        {id, {told(current, ref, error), waiting}}
      end)

    %{state | dynamic: %{state.dynamic | replaces: replaces}}
  end

  defp told(%{ref: ref} = request, ref, error) do
    reply(request, error)
    %{request | from: nil}
  end

  defp told(request, _ref, _error), do: request

  @doc "Fails the requests of callers that wait for a stage whose process has ended."
  @spec interrupted(State.t(), pos_integer()) :: State.t()
  def interrupted(state, id) do
    case state.dynamic.replaces do
      %{^id => {current, waiting}} ->
        path = state.graph.vertices[current.vertex].path

        for request <- [current | :queue.to_list(waiting)],
            do: reply(request, {:error, Errors.interrupted(path)})

        put(state, id, nil)

      _ ->
        state
    end
  end

  defp reply(%{from: nil}, _answer), do: :ok
  defp reply(%{from: from}, answer), do: GenServer.reply(from, answer)

  defp put(state, id, nil),
    do: %{state | dynamic: %{state.dynamic | replaces: Map.delete(state.dynamic.replaces, id)}}

  defp put(state, id, entry),
    do: %{
      state
      | dynamic: %{state.dynamic | replaces: Map.put(state.dynamic.replaces, id, entry)}
    }

  # A restart begins with this component and these options from now on.
  defp replaced(state, id, %{index: index, module: module, opts: opts}) do
    stage = Map.fetch!(state.stages, id)
    vertices = List.update_at(stage.vertices, index, &%{&1 | module: module, opts: opts})
    vertex = Enum.at(vertices, index)
    graph = %{state.graph | vertices: Map.put(state.graph.vertices, vertex.id, vertex)}
    %{state | graph: graph, stages: Map.put(state.stages, id, %{stage | vertices: vertices})}
  end

  # The new component

  # A new version of the same function keeps the operator's current state.
  defp target(%Vertex{module: :operator} = vertex, {:keep, step}) do
    with {:ok, :operator, step} <- target(vertex, step), do: {:ok, :operator, {:keep, step}}
  end

  defp target(%Vertex{module: :operator} = vertex, {kind, fun} = step) when is_function(fun) do
    if kind == elem(vertex.opts, 0),
      do: {:ok, :operator, step},
      else: {:error, other_kind(vertex)}
  end

  defp target(%Vertex{module: :operator} = vertex, {:step, _fun, _state} = step),
    do:
      if(elem(vertex.opts, 0) == :step,
        do: {:ok, :operator, step},
        else: {:error, other_kind(vertex)}
      )

  defp target(%Vertex{module: :operator} = vertex, _), do: {:error, other_kind(vertex)}

  defp target(vertex, {:keep, opts}), do: {:ok, vertex.module, {:keep, opts}}

  defp target(_vertex, {module, opts}) when is_atom(module) and is_list(opts) do
    if Code.ensure_loaded?(module) and function_exported?(module, :handle_message, 4),
      do: {:ok, module, opts},
      else: {:error, Error.new(:not_a_component, "#{inspect(module)} is not a component")}
  end

  defp target(vertex, opts) when is_list(opts), do: {:ok, vertex.module, opts}

  defp target(_vertex, other),
    do:
      {:error,
       Error.new(:bad_replacement, "expected {module, opts} or options, got: #{inspect(other)}")}

  defp other_kind(vertex) do
    Error.new(
      :bad_replacement,
      "#{vertex.path} is an operator of kind #{inspect(elem(vertex.opts, 0))}",
      fix: "replace it with a step of the same kind; see Situ.Operator"
    )
  end

  defp fits(_graph, %Vertex{module: same}, same), do: :ok

  defp fits(graph, vertex, module) do
    with :ok <- inputs_fit(graph, vertex, module.inputs()),
         do: outputs_fit(graph, vertex, module.outputs())
  end

  defp inputs_fit(graph, vertex, inputs) do
    Enum.find_value(Map.values(graph.edges), :ok, fn %Edge{from: {from, output}, to: {to, input}} ->
      type = graph.vertices[from].outputs[output].type

      if to == vertex.id and not accepts?(inputs[input], type),
        do: {:error, misfit(vertex, module_port(:input, input), inputs[input], type)}
    end)
  end

  defp outputs_fit(graph, vertex, outputs) do
    Enum.find_value(Map.values(graph.edges), :ok, fn %Edge{from: {from, output}, to: {to, input}} ->
      type = graph.vertices[to].inputs[input].type

      if from == vertex.id and
           (outputs[output] == nil or not Type.accepts?(type, port_type(outputs[output]))),
         do: {:error, misfit(vertex, module_port(:output, output), type, outputs[output])}
    end)
  end

  defp accepts?(nil, _type), do: false
  defp accepts?(port, type), do: Type.accepts?(port_type(port), type)

  defp port_type({type, opts}) when is_list(opts) and (opts == [] or is_tuple(hd(opts))), do: type
  defp port_type(type), do: type

  defp module_port(kind, name), do: "#{kind} #{inspect(name)}"

  defp misfit(vertex, port, wanted, given) do
    Error.new(:type_mismatch, "#{vertex.path} cannot be replaced: #{port} does not fit",
      why:
        "the port is connected: #{describe(given)} flows where #{describe(wanted)} is declared",
      meta: %{component: vertex.path}
    )
  end

  defp describe(nil), do: "nothing"
  defp describe(port), do: port |> port_type() |> Type.to_string()
end
