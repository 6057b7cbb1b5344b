defmodule Situ.Pipeline.Launch do
  @moduledoc false
  # What a start is made of, as plain data: clock and replay interval, wiring of each stage; and the errors of entering.
  alias Situ.{Clock, Error, Type}
  alias Situ.Graph.{Edge, Vertex}
  alias Situ.Stage.Counters

  @doc "The replay interval: what was proposed, cut by what was asked for."
  @spec interval([tuple()], tuple()) :: {Situ.Time.t() | :unbounded, Situ.Time.t() | :unbounded}
  def interval(proposals, asked), do: proposals |> coverage() |> intersect(asked)

  @doc "Clock, start time and replay end; a known start makes the clock virtual."
  @spec timing(Situ.Pipeline.Settings.t(), [tuple()]) :: map()
  def timing(settings, proposals) do
    {from, to} = interval(proposals, settings.interval)
    clock = clock(settings, from)

    %{
      clock: clock,
      enforce: settings.speed != :max,
      start_time: if(from == :unbounded, do: Clock.now(clock), else: from),
      replay_start: from,
      replay_end: if(to == :unbounded, do: :infinity, else: to)
    }
  end

  @doc "Counters of every edge between processes."
  @spec counters([Edge.t()]) :: %{pos_integer() => Counters.t()}
  def counters(edges), do: Map.new(edges, &{&1.id, Counters.new()})

  @doc "Edges with the stages they join instead of vertices."
  @spec links(Situ.Graph.Plan.t()) :: %{pos_integer() => map()}
  def links(plan) do
    place =
      for stage <- plan.stages, vertex <- stage.vertices, into: %{}, do: {vertex.id, stage.id}

    Map.new(plan.edges, fn %Edge{from: {from, output}, to: {to, input}} = edge ->
      {edge.id,
       %{
         id: edge.id,
         from: place[from],
         output: output,
         to: place[to],
         input: input,
         policy: edge.policy
       }}
    end)
  end

  @doc "What one stage is told at its start."
  @spec wiring(pos_integer(), map()) :: map()
  def wiring(id, state) do
    links = Map.values(state.links)
    pid = fn stage -> state.stages[stage].pid end

    inlets =
      for %{to: ^id} = link <- links,
          Map.has_key?(state.active, link.id) or state.step != :finalize do
        %{
          name: link.input,
          tag: link.id,
          producer: pid.(link.from),
          policy: link.policy,
          counters: state.counters[link.id]
        }
      end

    subs =
      links
      |> Enum.filter(&(&1.from == id))
      |> Enum.sort_by(& &1.id)
      |> Enum.group_by(& &1.output, &{&1.id, pid.(&1.to), state.counters[&1.id], &1.policy})

    state
    |> Map.take([:clock, :enforce, :start_time, :replay_start, :replay_end])
    |> Map.merge(%{
      control: state.stages[id].control,
      inlets: inlets,
      subs: subs,
      sizes: state.settings.message_sizes
    })
  end

  @doc "Checks a replacement and says which stage gets which request."
  @spec replacement(map(), term(), term()) :: {:ok, pos_integer(), tuple()} | {:error, Error.t()}
  def replacement(state, node, change) do
    with {:ok, vertex} <- find(state.graph, node),
         {:ok, stage, index} <- placed(state, vertex),
         {:ok, module, opts} <- target(vertex, change),
         :ok <- fits(state.graph, vertex, module) do
      {:ok, stage, {:replace, index, module, opts}}
    end
  end

  @doc false
  def not_running do
    Error.new(:not_running, "the pipeline is not running",
      why: "it has ended, or was never started"
    )
  end

  @doc false
  def crashed(reason),
    do: Error.new(:crashed, "the pipeline process died: #{inspect(reason, limit: 8)}")

  @doc false
  def timeout(request, ms),
    do:
      Error.new(:timeout, "no answer to #{inspect(request)} after #{ms} ms",
        why: "it goes on all the same"
      )

  @doc false
  def build_error(_spec, %Error{} = error, stack),
    do: %{error | meta: Map.put_new(error.meta, :stacktrace, stack)}

  def build_error(spec, {kind, reason}, stack), do: failed(spec, kind, reason, stack)
  def build_error(spec, exception, stack), do: failed(spec, :error, exception, stack)

  defp failed(spec, kind, reason, stack) do
    Error.new(
      :build_failed,
      "building #{inspect(spec)} failed: #{Exception.format_banner(kind, reason, stack)}",
      meta: %{kind: kind, reason: reason, stacktrace: stack}
    )
  end

  defp coverage([]), do: {:unbounded, :unbounded}

  defp coverage(proposals) do
    from = proposals |> Enum.map(&elem(&1, 0)) |> Enum.min()
    ends = Enum.map(proposals, &elem(&1, 1))
    {from, if(:unbounded in ends, do: :unbounded, else: Enum.max(ends))}
  end

  defp intersect({from, to}, {asked_from, asked_to}) do
    from = latest(from, asked_from)
    to = earliest(to, asked_to)
    {from, if(is_integer(from) and is_integer(to), do: max(from, to), else: to)}
  end

  defp latest(:unbounded, b), do: b
  defp latest(a, :unbounded), do: a
  defp latest(a, b), do: max(a, b)
  defp earliest(:unbounded, b), do: b
  defp earliest(a, :unbounded), do: a
  defp earliest(a, b), do: min(a, b)

  defp clock(%{clock: %Clock{} = clock}, _from), do: clock
  defp clock(%{speed: speed}, :unbounded) when speed in [:max, 1.0, 1], do: Clock.real()
  defp clock(%{speed: speed}, :unbounded), do: Clock.virtual(:os.system_time(), speed)
  defp clock(%{speed: :max}, from), do: Clock.virtual(from, 1.0)
  defp clock(%{speed: speed}, from), do: Clock.virtual(from, speed)

  defp find(graph, %Situ.Node{id: id}), do: Map.fetch(graph.vertices, id) |> found("node")

  defp find(graph, path) when is_binary(path) do
    case graph.paths do
      %{^path => id} -> Map.fetch(graph.vertices, id)
      _ -> {:error, unknown(path, Situ.Options.nearest(path, Map.keys(graph.paths)))}
    end
  end

  defp found({:ok, _} = ok, _), do: ok
  defp found(:error, what), do: {:error, unknown(what, nil)}

  defp unknown(path, near) do
    Error.new(:unknown_component, "no component #{inspect(path)}",
      fix: near && "did you mean #{inspect(near)}?"
    )
  end

  defp placed(state, vertex) do
    found =
      Enum.find_value(state.stages, fn {id, stage} ->
        index = Enum.find_index(stage.vertices, &(&1.id == vertex.id))
        index && stage.state == :running && {id, index}
      end)

    case found do
      {id, index} when state.phase == :running -> {:ok, id, index}
      _ -> {:error, not_running()}
    end
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
      fix: "replace it by a step of the same kind, as in Situ.Operator"
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
      why: "it is connected: #{describe(given)} flows where #{describe(wanted)} is declared",
      meta: %{component: vertex.path}
    )
  end

  defp describe(nil), do: "nothing"
  defp describe(port), do: port |> port_type() |> Type.to_string()
end
