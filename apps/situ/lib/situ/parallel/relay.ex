defmodule Situ.Parallel.Relay do
  @moduledoc false
  # Runs the pipeline of a branch on another node. A process on that node starts the pipeline and forwards all messages
  # in both directions. As it is the only sender on its side, messages arrive in order. It ends with the operator, the
  # pipeline, or the connection of the nodes.
  #
  # The other node has its own clock. If the operator's pipeline follows the wall clock, so does the branch; otherwise
  # the branch's clock starts at the time at which the branch starts, and moves at the speed of the wall clock.
  alias Situ.{Clock, Error}
  alias Situ.Parallel.BranchPipeline

  @doc "Starts a branch on another node, like `Situ.Parallel.BranchPipeline.start!/2`."
  @spec start!((Situ.Stream.t() -> term()), BranchPipeline.place()) :: BranchPipeline.built()
  def start!(fun, %{id: id, node: node, timing: timing} = place) do
    place = %{place | timing: Map.update!(timing, :clock, &describe_clock/1)}
    {pid, monitor} = Node.spawn_monitor(node, __MODULE__, :run_branch, [self(), fun, place])

    receive do
      {:situ_branch, ^id, {:built, built}} ->
        Process.demonitor(monitor, [:flush])
        Map.put(built, :pid, pid)

      {:situ_branch, ^id, {:refused, error}} ->
        Process.demonitor(monitor, [:flush])
        raise error

      {:DOWN, ^monitor, :process, ^pid, reason} ->
        raise start_error(place, reason)
    end
  end

  defp start_error(%{path: path, node: node}, reason) do
    Error.new(:branch_node_down, "#{path} cannot start on #{node}",
      why: if(reason == :noconnection, do: "the node is not connected", else: inspect(reason)),
      fix: "connect the node with Node.connect/1, and load the same code on it"
    )
  end

  defp describe_clock(%Clock{kind: :real}), do: :real
  defp describe_clock(clock), do: Clock.now(clock)

  @doc false
  def run_branch(owner, fun, %{id: id, timing: timing} = place) do
    Process.monitor(owner)
    clock = if timing.clock == :real, do: Clock.real(), else: Clock.virtual(timing.clock)
    place = %{place | node: node(), timing: %{timing | clock: clock}}
    {pipeline, built} = fun |> BranchPipeline.start!(place) |> Map.pop!(:pid)
    Process.monitor(pipeline)
    send(owner, {:situ_branch, id, {:built, built}})
    forward_messages(%{owner: owner, id: id, pipeline: pipeline, gate: nil})
  rescue
    error in Error -> send(owner, {:situ_branch, id, {:refused, error}})
  end

  defp forward_messages(%{owner: owner, id: id, pipeline: pipeline} = state) do
    receive do
      {:situ_branch, ^id, {:open, gate, _pipeline}} ->
        send(owner, {:situ_branch, id, {:open, self(), self()}})
        forward_messages(%{state | gate: gate})

      {:situ_branch, ^id, _content} = message ->
        send(owner, message)
        forward_messages(state)

      {:situ_feed, _entries} = message ->
        send(state.gate, message)
        forward_messages(state)

      # The report concerns this node only.
      {^id, result} ->
        send(owner, {id, if(match?({:ok, _}, result), do: {:ok, nil}, else: result)})

      {:DOWN, _monitor, :process, ^pipeline, reason} ->
        exit(reason)

      {:DOWN, _monitor, :process, ^owner, _reason} ->
        :ok

      request ->
        send(pipeline, request)
        forward_messages(state)
    end
  end
end
