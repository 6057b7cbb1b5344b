defmodule Situ.Pipeline.Dynamic.Input do
  @moduledoc false
  # Adds inputs to a running component and removes them. Three steps define exactly which messages the input receives:
  #
  #   1. The source's stage adds a subscriber without demand, and reports the last time that the subscriber will not
  #      see (`{:lend, ...}`).
  #   2. The component accepts or rejects the input, and asks for the first messages (`{:attach, ...}`).
  #   3. The caller receives its reply, and the graph has the connection.
  #
  # An input takes part from an originating time and not from the moment of the call. Otherwise
  # the outputs would depend on when the call arrived, and a replay would differ from its
  # recording. A stream of "input added" events was rejected, because it would carry streams as
  # data, which cannot be recorded.
  alias Situ.{Delivery, Error}
  alias Situ.Graph.Edge
  alias Situ.Lifecycle.{Errors, Operations}
  alias Situ.Pipeline.{Stages, State}
  alias Situ.Ports.Counters

  @type events :: [Situ.Lifecycle.event()]

  @doc "Adds an input, connected to the stream `stream`, to the component that emits the stream `taker`."
  @spec attach(State.t(), Operations.id(), map()) :: {State.t(), events()}
  def attach(state, op, change) do
    with {:ok, {id, _}} <- State.fetch_port(state, change.taker),
         {:ok, taker} <- fetch_taker(state, id),
         {:ok, {origin, output}} <- State.fetch_port(state, change.stream),
         {:ok, source} <- State.fetch_output_stage(state, origin),
         :ok <- check_no_cycle(state.graph, id, origin) do
      {lend_output(state, {id, taker}, {origin, output, source}, change, op), []}
    else
      {:error, error} -> refuse(state, op, error)
    end
  end

  @doc "Removes an added input."
  @spec detach(State.t(), Operations.id(), map()) :: {State.t(), events()}
  def detach(state, op, change) do
    with {:ok, {id, _}} <- State.fetch_port(state, change.taker),
         {:ok, stage} <- fetch_taker(state, id) do
      ref = make_ref()
      Stages.send_request(state, stage.id, {:detach, ref, change.request})
      {put_request(state, ref, %{op: op, stages: [stage.id], link: nil}), []}
    else
      {:error, error} -> refuse(state, op, error)
    end
  end

  defp refuse(state, op, error), do: {state, [{:finished, op, {:error, error}}]}

  @doc "Handles a source that has added the subscriber: asks the component to accept the input."
  @spec request_attachment(State.t(), term(), term()) :: {State.t(), events()}
  def request_attachment(
        %{life: %{phase: :running}, dynamic: %{inputs: inputs}} = state,
        tag,
        how
      )
      when is_map_key(inputs, tag) do
    %{link: link, request: request} = pending = inputs[tag]

    wiring = %{
      name: link.input,
      tag: tag,
      producer: state.stages[link.from].pid,
      policy: link.policy,
      counters: state.wires.counters[tag],
      sizes: state.settings.message_sizes,
      end: how
    }

    Stages.send_request(state, link.to, {:attach, request, elem(how, 1), wiring})
    state = put_request(state, tag, %{pending | stages: [link.to]})
    {update_wires(state, &%{&1 | links: Map.put(&1.links, tag, link)}), [{:linked, tag, link}]}
  end

  def request_attachment(state, tag, _how), do: fail_request(state, tag, Errors.not_running())

  @doc "Handles the component's reply."
  @spec handle_attach_reply(State.t(), term(), pos_integer(), term(), keyword()) ::
          {State.t(), events()}
  def handle_attach_reply(state, ref, id, {:ok, reply}, opts) do
    {pending, inputs} = Map.pop(state.dynamic.inputs, ref)
    finished = if pending, do: [{:finished, pending.op, {:ok, reply}}], else: []
    state = %{state | dynamic: %{state.dynamic | inputs: inputs}}

    added = fn vertex ->
      %{vertex | opts: opts, inputs: extended_inputs(vertex, pending && pending.link)}
    end

    {update_head_vertex(state, id, added), finished}
  end

  def handle_attach_reply(state, ref, _id, {:error, error}, _opts),
    do: fail_request(state, ref, error)

  @doc "Handles a component that has detached an input."
  @spec handle_detached(State.t(), pos_integer(), atom(), keyword()) :: {State.t(), events()}
  def handle_detached(state, id, input, opts) do
    state =
      update_head_vertex(state, id, &%{&1 | opts: opts, inputs: Keyword.delete(&1.inputs, input)})

    case Enum.find(state.wires.links, fn {_, link} -> link.to == id and link.input == input end) do
      {tag, _} -> {delete_edge(state, tag), [{:unlinked, tag}]}
      nil -> {state, []}
    end
  end

  @doc "Fails the requests that wait for a stage whose process has ended."
  @spec fail_pending(State.t(), pos_integer()) :: {State.t(), events()}
  def fail_pending(state, id) do
    error = Errors.component_restarted(hd(state.stages[id].vertices).path)

    for {ref, %{stages: stages}} <- state.dynamic.inputs, id in stages, reduce: {state, []} do
      {state, events} ->
        {state, more} = fail_request(state, ref, error)
        {state, events ++ more}
    end
  end

  defp lend_output(state, {id, taker}, {origin, output, source}, change, op) do
    tag = state.graph.next_edge
    input = free_input_name(state, id, change.input)
    policy = change.policy || state.graph.default_policy || Delivery.unlimited()
    edge = %Edge{id: tag, from: {origin, output}, to: {id, input}, policy: policy, explicit: true}
    link = Stages.build_link(edge, source.id, taker.id)
    counters = Counters.new()
    lent = Stages.subscriber_policy(policy, taker)
    Stages.send_request(state, source.id, {:lend, tag, output, taker.pid, counters, lent})
    edges = Map.put(state.graph.edges, tag, edge)
    state = %{state | graph: %{state.graph | edges: edges, next_edge: tag + 1}}
    state = update_wires(state, &%{&1 | counters: Map.put(&1.counters, tag, counters)})

    put_request(state, tag, %{
      op: op,
      stages: [source.id, taker.id],
      link: link,
      request: change.request
    })
  end

  defp put_request(state, ref, pending),
    do: %{state | dynamic: %{state.dynamic | inputs: Map.put(state.dynamic.inputs, ref, pending)}}

  defp update_wires(state, change), do: %{state | wires: change.(state.wires)}

  # The smallest free name is used, so that there are only as many atoms as inputs at the same time.
  defp free_input_name(state, id, name) do
    pending = for {_, %{link: %{to: ^id, input: input}}} <- state.dynamic.inputs, do: input
    names = pending ++ Keyword.keys(state.graph.vertices[id].inputs)

    Stream.iterate(0, &(&1 + 1)) |> Stream.map(name) |> Enum.find(&(&1 not in names))
  end

  defp fetch_taker(state, id) do
    with {:ok, stage, index} <- State.fetch_stage(state, id) do
      vertex = state.graph.vertices[id]

      if index == 0 and vertex.module != :operator and
           function_exported?(vertex.module, :handle_attach, 5),
         do: {:ok, stage},
         else: {:error, fixed_inputs_error(vertex)}
    end
  end

  # A component that depends on its own output would wait for itself.
  defp check_no_cycle(graph, id, origin) do
    next = Enum.group_by(graph.edges, fn {_, e} -> elem(e.from, 0) end, &elem(elem(&1, 1).to, 0))

    if origin in collect_downstream([id], next, []),
      do: {:error, cycle_error(graph.vertices[origin])},
      else: :ok
  end

  defp collect_downstream([], _next, seen), do: seen

  defp collect_downstream([id | rest], next, seen) do
    if id in seen,
      do: collect_downstream(rest, next, seen),
      else: collect_downstream(Map.get(next, id, []) ++ rest, next, [id | seen])
  end

  defp extended_inputs(vertex, nil), do: vertex.inputs

  defp extended_inputs(vertex, link),
    do: vertex.inputs ++ [{link.input, %{type: :any, optional: true}}]

  # Changes the first vertex of a stage, with which a restart begins. Also changes it in the graph, unless it was
  # removed there.
  defp update_head_vertex(state, id, fun) do
    stage = Map.fetch!(state.stages, id)
    [head | rest] = stage.vertices
    vertices = replace_existing(state.graph.vertices, head.id, fun.(head))
    stages = Map.put(state.stages, id, %{stage | vertices: [fun.(head) | rest]})
    %{state | graph: %{state.graph | vertices: vertices}, stages: stages}
  end

  defp replace_existing(map, key, value) when is_map_key(map, key), do: %{map | key => value}
  defp replace_existing(map, _key, _value), do: map

  defp fail_request(state, ref, error) do
    case Map.pop(state.dynamic.inputs, ref) do
      {nil, _} ->
        {state, []}

      {pending, inputs} ->
        state = %{state | dynamic: %{state.dynamic | inputs: inputs}}
        {state, events} = if pending.link, do: cut_link(state, pending.link), else: {state, []}
        {state, events ++ [{:finished, pending.op, {:error, error}}]}
    end
  end

  defp cut_link(state, link) do
    Stages.send_request(state, link.from, {:untap, link.id})
    {delete_edge(state, link.id), [{:unlinked, link.id}]}
  end

  defp delete_edge(state, tag),
    do: %{state | graph: %{state.graph | edges: Map.delete(state.graph.edges, tag)}}

  defp fixed_inputs_error(vertex) do
    Error.new(:fixed_inputs, "#{vertex.path} does not accept new inputs while it is running",
      why: "its inputs are fixed when the pipeline starts",
      fix: "build it on a map of streams (Situ.join/4), or with Situ.merge/3",
      meta: %{component: vertex.path}
    )
  end

  defp cycle_error(vertex) do
    Error.new(:circle, "#{vertex.path} depends on the operator that would receive its stream",
      why: "each would wait for the other",
      fix: "use a stream upstream of the operator",
      meta: %{component: vertex.path}
    )
  end
end
