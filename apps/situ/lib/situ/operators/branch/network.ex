defmodule Situ.Branch.Network do
  @moduledoc false
  # A branch of any shape. The outputs of each component pass through the whole graph before the next message.
  alias Situ.{Error, Message}
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  require Chain

  @enforce_keys [:nodes, :inlet, :result, :context]
  defstruct [:nodes, :inlet, :result, :context, out: []]

  @type t :: %__MODULE__{}

  @spec start(Situ.Graph.t(), pos_integer(), {pos_integer(), atom()} | nil, String.t(), term()) ::
          t()
  def start(graph, inlet, result, path, context) do
    subs = Enum.group_by(graph.edges, fn {_, e} -> e.from end, fn {_, e} -> e.to end)
    nodes = Map.new(graph.vertices, fn {id, v} -> {id, node(v, subs, path)} end)
    context = context || %Situ.Component.Context{path: path}
    network = %__MODULE__{nodes: nodes, inlet: inlet, result: result, context: context}
    graph.vertices |> Map.keys() |> Enum.sort() |> Enum.reduce(network, &begin/2)
  end

  @spec push(t(), Message.t()) :: {Situ.Branch.outputs(), t()}
  def push(network, message) do
    taken(emit(%{network | out: []}, {network.inlet, :out}, message))
  end

  @spec close(t(), Situ.Time.t()) :: Situ.Branch.outputs()
  def close(network, time) do
    {outputs, _network} = taken(shut(%{network | out: []}, {network.inlet, :out}, time))
    outputs
  end

  defp taken(%{out: out} = network), do: {:lists.reverse(out), %{network | out: []}}

  defp node(vertex, subs, path) do
    outs =
      Map.new(vertex.outputs, fn {name, _} -> {name, Map.get(subs, {vertex.id, name}, [])} end)

    base = %{path: path <> "." <> vertex.path, outs: outs, id: vertex.id}

    case vertex.module do
      :operator -> Map.put(base, :chain, Chain.new([vertex.opts]))
      Situ.Branch.Inlet -> base
      module -> component(base, module, vertex)
    end
  end

  defp component(base, module, vertex) do
    case Callback.init(module, vertex.opts, base.path) do
      {:ok, core} ->
        open = for {name, _} <- vertex.inputs, do: name
        Map.merge(base, %{module: module, core: core, open: open})

      {:error, error} ->
        raise error
    end
  end

  defp begin(id, network) do
    case Map.fetch!(network.nodes, id) do
      %{module: _} = node -> call(network, node, :handle_start, [network.context, node.core])
      _ -> network
    end
  end

  # Emits a message from an output: to the result, and to every connected input.
  defp emit(network, {id, output} = from, message) do
    network =
      if from == network.result,
        do: %{network | out: [{message.originating_time, message.data} | network.out]},
        else: network

    network.nodes
    |> Map.fetch!(id)
    |> subscribers(output)
    |> Enum.reduce(network, fn to, network -> deliver(network, to, message) end)
  end

  defp deliver(network, {id, input}, message) do
    case Map.fetch!(network.nodes, id) do
      %{chain: chain} = node -> operate(network, node, chain, message)
      node -> handle(network, node, input, message)
    end
  end

  defp operate(network, node, chain, message) do
    case Chain.run_stateful(chain, message.data, message) do
      {Chain.skip(), chain} ->
        keep(network, %{node | chain: chain})

      {data, chain} ->
        network |> keep(%{node | chain: chain}) |> emit({node.id, :out}, %{message | data: data})
    end
  catch
    {:situ_step, _index, kind, reason, stack} ->
      raise Callback.failure(node.path, :in, kind, reason, stack)
  end

  defp handle(network, node, input, message) do
    context = %{network.context | path: node.path}
    call(network, node, :handle_message, [input, message, context, node.core])
  end

  defp call(network, node, callback, args) do
    case Callback.run(node.module, callback, args, node.path) do
      {:ok, actions, core} ->
        Enum.reduce(actions, keep(network, %{node | core: core}), &act(&1, node, &2))

      {:error, error} ->
        raise error
    end
  end

  defp act({output, time, data}, node, network)
       when is_integer(time) and output not in [:close, :timer] do
    emit(network, {node.id, output}, %Message{data: data, originating_time: time})
  end

  defp act({output, %Message{} = message}, node, network),
    do: emit(network, {node.id, output}, message)

  defp act({:continue, term}, node, network) do
    context = %{network.context | path: node.path}
    args = [{:continue, term}, context, Map.fetch!(network.nodes, node.id).core]
    call(network, node, :handle_info, args)
  end

  defp act({:close, output}, node, network), do: shut(network, {node.id, output}, 0)
  defp act({:close, output, time}, node, network), do: shut(network, {node.id, output}, time)

  # Messages arrive one at a time, so no input can run ahead of another.
  defp act({balance, _input}, _node, network) when balance in [:hold, :resume, :complete],
    do: network

  defp act(action, node, _network) do
    raise Error.new(:not_in_branch, "#{node.path} cannot run inside a parallel branch",
            why: "it returned #{inspect(action, limit: 5)}, and a branch has no clock",
            fix: "give parallel branches: :processes, or move it before or after the operator"
          )
  end

  # Closes an output. Components notify their dependents, and end with their last input.
  defp shut(network, {id, output}, time) do
    network.nodes
    |> Map.fetch!(id)
    |> subscribers(output)
    |> Enum.reduce(network, fn to, network -> closed(network, to, time) end)
  end

  defp closed(network, {id, input}, time) do
    case Map.fetch!(network.nodes, id) do
      %{chain: _} ->
        shut(network, {id, :out}, time)

      node ->
        node = %{node | open: List.delete(node.open, input)}
        context = %{network.context | path: node.path}
        network = call(network, node, :handle_closed, [input, time, context, node.core])
        if node.open == [], do: shut_all(network, node, time), else: network
    end
  end

  defp shut_all(network, node, time) do
    Enum.reduce(node.outs, network, fn {output, _}, network ->
      shut(network, {node.id, output}, time)
    end)
  end

  defp subscribers(%{outs: outs}, output), do: Map.get(outs, output, [])
  defp keep(network, node), do: %{network | nodes: Map.put(network.nodes, node.id, node)}
end
