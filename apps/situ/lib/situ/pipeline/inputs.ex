defmodule Situ.Pipeline.Inputs do
  @moduledoc false
  # Inputs that are added to a running component, and taken away. Three steps, so that it is exact which messages come:
  #
  #   the source's stage takes a subscriber in, without demand, and tells the last time that it will not see ({:lend, ...});
  #   the component takes the input, or does not, and asks for the first messages ({:attach, ...});
  #   the caller gets its answer, and the graph has the connection.
  alias Situ.{Delivery, Error}
  alias Situ.Graph.Edge
  alias Situ.Pipeline.{Launch, Life, Place}
  alias Situ.Stage.Counters

  @typedoc "What the caller waits for: `stages` are those that owe an answer."
  @type asked :: %{from: GenServer.from(), stages: [pos_integer()]}

  @doc "An input of the component behind the stream `taker`, connected to the stream `which`."
  @spec attach(Life.t(), map(), GenServer.from()) :: {:ok | {:error, Error.t()}, Life.t()}
  def attach(%{phase: :running} = state, asked, from) do
    with {:ok, {id, _}} <- Place.port(state, asked.taker),
         {:ok, taker} <- taker(state, id),
         {:ok, {origin, output}} <- Place.port(state, asked.stream),
         {:ok, source} <- Place.outlet(state, origin),
         :ok <- upstream(state.graph, id, origin) do
      {:ok, lend(state, {id, taker}, {origin, output, source}, asked, from)}
    else
      {:error, error} -> {{:error, error}, state}
    end
  end

  def attach(state, _asked, _from), do: {{:error, Launch.not_running()}, state}

  @doc "An added input shall go."
  @spec detach(Life.t(), term(), term(), GenServer.from()) ::
          {:ok | {:error, Error.t()}, Life.t()}
  def detach(%{phase: :running} = state, taker, request, from) do
    with {:ok, {id, _}} <- Place.port(state, taker), {:ok, stage} <- taker(state, id) do
      ref = make_ref()
      send(stage.pid, {:situ, {:detach, ref, request}})
      {:ok, ask(state, ref, %{from: from, stages: [stage.id], link: nil})}
    else
      {:error, error} -> {{:error, error}, state}
    end
  end

  def detach(state, _taker, _request, _from), do: {{:error, Launch.not_running()}, state}

  @doc "The source has taken the subscriber in: now the component is asked."
  @spec lent(Life.t(), pos_integer(), term()) :: Life.t()
  def lent(%{phase: :running} = state, tag, how) when is_map_key(state.inputs, tag) do
    %{link: link, request: request} = asked = state.inputs[tag]
    taker = state.stages[link.to]

    wiring = %{
      name: link.input,
      tag: tag,
      producer: state.stages[link.from].pid,
      policy: link.policy,
      counters: state.counters[tag],
      sizes: state.settings.message_sizes,
      end: how
    }

    send(taker.pid, {:situ, {:attach, request, elem(how, 1), wiring}})
    state = ask(state, tag, %{asked | stages: [taker.id]})
    %{state | links: Map.put(state.links, tag, link), active: Map.put(state.active, tag, link)}
  end

  def lent(state, tag, _how), do: refused(state, tag, Launch.not_running())

  @doc "The component has answered."
  @spec answered(Life.t(), term(), pos_integer(), term(), keyword()) :: Life.t()
  def answered(state, ref, id, {:ok, reply}, opts) do
    {asked, inputs} = Map.pop(state.inputs, ref)
    if asked, do: GenServer.reply(asked.from, {:ok, reply})
    state = %{state | inputs: inputs}

    change(state, id, fn vertex ->
      %{vertex | opts: opts, inputs: added(vertex, asked && asked.link)}
    end)
  end

  def answered(state, ref, _id, {:error, error}, _opts), do: refused(state, ref, error)

  @doc "The component has let an input go."
  @spec detached(Life.t(), pos_integer(), atom(), keyword()) :: Life.t()
  def detached(state, id, input, opts) do
    state = change(state, id, &%{&1 | opts: opts, inputs: Keyword.delete(&1.inputs, input)})

    case Enum.find(state.links, fn {_, link} -> link.to == id and link.input == input end) do
      {tag, _} -> forget(state, tag)
      nil -> state
    end
  end

  @doc "A stage that may owe an answer was restarted: it has forgotten the question."
  @spec interrupted(Life.t(), pos_integer()) :: Life.t()
  def interrupted(state, id) do
    error = Error.new(:component_restarted, "the component was restarted in the middle of this")

    for {ref, %{stages: stages}} <- state.inputs, id in stages, reduce: state do
      state -> refused(state, ref, error)
    end
  end

  defp lend(state, {id, taker}, {origin, output, source}, asked, from) do
    tag = state.graph.next_edge
    input = free(state, id, asked.input)
    policy = asked.policy || state.graph.default_policy || Delivery.unlimited()
    edge = %Edge{id: tag, from: {origin, output}, to: {id, input}, policy: policy, explicit: true}
    ends = %{from: source.id, output: output, to: taker.id, input: input}
    link = Map.merge(ends, %{id: tag, policy: policy})
    counters = Counters.new()
    send(source.pid, {:situ, {:lend, tag, output, taker.pid, counters, policy}})
    edges = Map.put(state.graph.edges, tag, edge)

    ask(
      %{
        state
        | graph: %{state.graph | edges: edges, next_edge: tag + 1},
          counters: Map.put(state.counters, tag, counters)
      },
      tag,
      %{from: from, stages: [source.id], link: link, request: asked.request}
    )
  end

  defp ask(state, ref, asked), do: %{state | inputs: Map.put(state.inputs, ref, asked)}

  # The smallest free name: as many atoms as there ever are inputs at once.
  defp free(state, id, name) do
    asked = for {_, %{link: %{to: ^id, input: input}}} <- state.inputs, do: input
    taken = asked ++ Keyword.keys(state.graph.vertices[id].inputs)

    Stream.iterate(0, &(&1 + 1))
    |> Stream.map(name)
    |> Enum.find(&(&1 not in taken))
  end

  defp taker(state, id) do
    with {:ok, stage, index} <- Place.stage(state, id) do
      vertex = state.graph.vertices[id]

      if index == 0 and vertex.module != :operator and
           function_exported?(vertex.module, :handle_attach, 5),
         do: {:ok, stage},
         else: {:error, fixed(vertex)}
    end
  end

  # A stream that comes from the component itself would wait for it.
  defp upstream(graph, id, origin) do
    next = Enum.group_by(graph.edges, fn {_, e} -> elem(e.from, 0) end, &elem(elem(&1, 1).to, 0))

    if origin in downstream([id], next, []),
      do: {:error, circle(graph.vertices[origin])},
      else: :ok
  end

  defp downstream([], _next, seen), do: seen

  defp downstream([id | rest], next, seen) do
    if id in seen,
      do: downstream(rest, next, seen),
      else: downstream(Map.get(next, id, []) ++ rest, next, [id | seen])
  end

  defp added(vertex, nil), do: vertex.inputs

  defp added(vertex, link),
    do: vertex.inputs ++ [{link.input, %{type: :any, optional: true}}]

  # The first vertex of a stage, in the graph and in what a restart begins with.
  defp change(state, id, fun) do
    stage = Map.fetch!(state.stages, id)
    [head | rest] = stage.vertices
    head = fun.(head)
    vertices = Map.put(state.graph.vertices, head.id, head)
    stages = Map.put(state.stages, id, %{stage | vertices: [head | rest]})
    %{state | graph: %{state.graph | vertices: vertices}, stages: stages}
  end

  defp refused(state, ref, error) do
    case Map.pop(state.inputs, ref) do
      {nil, _} ->
        state

      {asked, inputs} ->
        GenServer.reply(asked.from, {:error, error})
        state = %{state | inputs: inputs}
        if asked.link, do: cut(state, asked.link), else: state
    end
  end

  defp cut(state, link) do
    send(state.stages[link.from].pid, {:situ, {:untap, link.id}})
    forget(state, link.id)
  end

  defp forget(state, tag) do
    %{
      state
      | graph: %{state.graph | edges: Map.delete(state.graph.edges, tag)},
        links: Map.delete(state.links, tag),
        active: Map.delete(state.active, tag),
        counters: Map.delete(state.counters, tag)
    }
  end

  defp fixed(vertex) do
    Error.new(:fixed_inputs, "#{vertex.path} takes no inputs while it runs",
      why: "its inputs are fixed when the pipeline starts",
      fix: "build it over a map of streams (Situ.join/4), or with Situ.merge/3",
      meta: %{component: vertex.path}
    )
  end

  defp circle(vertex) do
    Error.new(:circle, "#{vertex.path} depends on the operator that shall take it",
      why: "each would wait for the other",
      fix: "take a stream in front of the operator",
      meta: %{component: vertex.path}
    )
  end
end
