defmodule Situ.Branch.Network do
  @moduledoc false
  # A branch of any shape. The outputs of each component pass through the whole graph before the next message.
  alias Situ.{Error, Message}
  alias Situ.Component.{Callback, Snapshot}
  alias Situ.Operator.Chain
  require Chain

  @enforce_keys [:nodes, :inlet, :result, :context]
  defstruct [:nodes, :inlet, :result, :context, out: []]

  @type t :: %__MODULE__{}

  @spec from_graph(
          Situ.Graph.t(),
          pos_integer(),
          {pos_integer(), atom()} | nil,
          String.t(),
          term()
        ) ::
          t()
  def from_graph(graph, inlet, result, path, context) do
    subs = Enum.group_by(graph.edges, fn {_, e} -> e.from end, fn {_, e} -> e.to end)
    nodes = Map.new(graph.vertices, fn {id, v} -> {id, build_node(v, subs, path)} end)
    context = context || %Situ.Component.Context{path: path}
    network = %__MODULE__{nodes: nodes, inlet: inlet, result: result, context: context}
    graph.vertices |> Map.keys() |> Enum.sort() |> Enum.reduce(network, &start_node/2)
  end

  @spec push(t(), Message.t()) :: {Situ.Branch.outputs(), t()}
  def push(network, message) do
    take_outputs(emit_message(%{network | out: []}, {network.inlet, :out}, message))
  end

  @spec close(t(), Situ.Time.t()) :: Situ.Branch.outputs()
  def close(network, time) do
    {outputs, _network} =
      take_outputs(close_output(%{network | out: []}, {network.inlet, :out}, time))

    outputs
  end

  @doc "Returns the states of the components and operators as plain data."
  @spec take_snapshot(t()) :: {:ok, map()} | {:error, Error.t()}
  def take_snapshot(network),
    do: Snapshot.map_states(network.nodes, fn _id, node -> snapshot_node(node) end)

  defp snapshot_node(%{chain: chain} = node), do: Snapshot.to_plain_data(chain, node.path)

  defp snapshot_node(%{core: core} = node) do
    with {:ok, plain} <- Snapshot.take_snapshot(node.module, core, node.path),
         do: {:ok, {plain, node.open}}
  end

  defp snapshot_node(_input), do: {:ok, nil}

  @doc "Restores the states into a network that has just started."
  @spec restore_snapshot(t(), map()) :: {:ok, t()} | {:error, Error.t()}
  def restore_snapshot(network, plain) do
    with {:ok, nodes} <- Snapshot.map_states(network.nodes, &restore_node(&2, plain[&1])),
         do: {:ok, %{network | nodes: nodes}}
  end

  defp restore_node(%{chain: chain} = node, plain) do
    with {:ok, chain} <- Snapshot.fill_functions(plain, chain, node.path),
         do: {:ok, %{node | chain: chain}}
  end

  defp restore_node(%{core: core} = node, {plain, open}) do
    with {:ok, core} <- Snapshot.restore_state(node.module, plain, core, node.path),
         do: {:ok, %{node | core: core, open: open}}
  end

  defp restore_node(input, _plain), do: {:ok, input}

  defp take_outputs(%{out: out} = network), do: {:lists.reverse(out), %{network | out: []}}

  defp build_node(vertex, subs, path) do
    outs =
      Map.new(vertex.outputs, fn {name, _} -> {name, Map.get(subs, {vertex.id, name}, [])} end)

    base = %{path: path <> "." <> vertex.path, outs: outs, id: vertex.id}

    case vertex.module do
      :operator -> Map.put(base, :chain, Chain.build_steps([vertex.opts]))
      Situ.Branch.Input -> base
      module -> init_component(base, module, vertex)
    end
  end

  defp init_component(base, module, vertex) do
    case Callback.run_init(module, vertex.opts, base.path) do
      {:ok, core} ->
        open = for {name, _} <- vertex.inputs, do: name
        Map.merge(base, %{module: module, core: core, open: open})

      {:error, error} ->
        raise error
    end
  end

  defp start_node(id, network) do
    case Map.fetch!(network.nodes, id) do
      %{module: _} = node ->
        run_callback(network, node, :handle_start, [network.context, node.core])

      _ ->
        network
    end
  end

  # Emits a message from an output: to the result, and to every connected input.
  defp emit_message(network, {id, output} = from, message) do
    network =
      if from == network.result,
        do: %{network | out: [{message.originating_time, message.data} | network.out]},
        else: network

    network.nodes
    |> Map.fetch!(id)
    |> output_subscribers(output)
    |> Enum.reduce(network, fn to, network -> deliver_message(network, to, message) end)
  end

  defp deliver_message(network, {id, input}, message) do
    case Map.fetch!(network.nodes, id) do
      %{chain: chain} = node -> run_operator(network, node, chain, message)
      node -> run_component(network, node, input, message)
    end
  end

  defp run_operator(network, node, chain, message) do
    case Chain.run_stateful(chain, message.data, message) do
      {Chain.skip(), chain} ->
        put_node(network, %{node | chain: chain})

      {data, chain} ->
        network
        |> put_node(%{node | chain: chain})
        |> emit_message({node.id, :out}, %{message | data: data})
    end
  catch
    {:situ_step, _index, kind, reason, stack} ->
      raise Callback.exception_error(node.path, :in, kind, reason, stack)
  end

  defp run_component(network, node, input, message) do
    context = %{network.context | path: node.path}
    run_callback(network, node, :handle_message, [input, message, context, node.core])
  end

  defp run_callback(network, node, callback, args) do
    case Callback.run_callback(node.module, callback, args, node.path) do
      {:ok, actions, core} ->
        Enum.reduce(actions, put_node(network, %{node | core: core}), &apply_action(&1, node, &2))

      {:error, error} ->
        raise error
    end
  end

  defp apply_action({output, time, data}, node, network)
       when is_integer(time) and output not in [:close, :timer] do
    emit_message(network, {node.id, output}, %Message{data: data, originating_time: time})
  end

  defp apply_action({output, [_ | _] = times, data}, node, network) do
    times
    |> Enum.zip(data)
    |> Enum.reduce(network, fn {time, value}, network ->
      apply_action({output, time, value}, node, network)
    end)
  end

  defp apply_action({output, %Message{} = message}, node, network),
    do: emit_message(network, {node.id, output}, message)

  defp apply_action({:continue, term}, node, network) do
    context = %{network.context | path: node.path}
    args = [{:continue, term}, context, Map.fetch!(network.nodes, node.id).core]
    run_callback(network, node, :handle_info, args)
  end

  defp apply_action({:close, output}, node, network),
    do: close_output(network, {node.id, output}, 0)

  defp apply_action({:close, output, time}, node, network),
    do: close_output(network, {node.id, output}, time)

  # Messages arrive one at a time, so no input can run ahead of another.
  defp apply_action({balance, _input}, _node, network)
       when balance in [:hold, :resume, :complete],
       do: network

  defp apply_action(action, node, _network) do
    raise Error.new(:not_in_branch, "#{node.path} cannot run inside a parallel branch",
            why: "it returned #{inspect(action, limit: 5)}, and a branch has no clock",
            fix: "give parallel branches: :processes, or move it before or after the operator"
          )
  end

  # Closes an output. Components notify their dependents, and end with their last input.
  defp close_output(network, {id, output}, time) do
    network.nodes
    |> Map.fetch!(id)
    |> output_subscribers(output)
    |> Enum.reduce(network, fn to, network -> close_input(network, to, time) end)
  end

  defp close_input(network, {id, input}, time) do
    case Map.fetch!(network.nodes, id) do
      %{chain: _} ->
        close_output(network, {id, :out}, time)

      node ->
        node = %{node | open: List.delete(node.open, input)}
        context = %{network.context | path: node.path}
        network = run_callback(network, node, :handle_closed, [input, time, context, node.core])
        if node.open == [], do: close_all_outputs(network, node, time), else: network
    end
  end

  defp close_all_outputs(network, node, time) do
    Enum.reduce(node.outs, network, fn {output, _}, network ->
      close_output(network, {node.id, output}, time)
    end)
  end

  defp output_subscribers(%{outs: outs}, output), do: Map.get(outs, output, [])
  defp put_node(network, node), do: %{network | nodes: Map.put(network.nodes, node.id, node)}
end
