defmodule Situ.Parallel.BranchPipeline do
  @moduledoc false
  # The pipeline of a branch. It sends these messages to the process that started it:
  #   {:situ_branch, id, {:open, gate, pipeline}}                   the process that accepts {:situ_feed, entries}
  #   {:situ_branch, id, {:outputs, [{time, data}], passed_time}}   outputs; if `passed_time` is a time, the branch has
  #                                                                 handled all input up to it (only sent by chains of
  #                                                                 light operators)
  #   {id, result}                                                  the branch has ended; no more output follows
  #
  # The pipeline accepts {:situ_stop, time}: it ends at the time, after it has handled all entries sent to it. It also
  # ends with the process that started it.
  alias Situ.Graph.{Builder, Plan}
  alias Situ.{Delivery, Error, Operator, Pipeline, Stream}
  alias Situ.Parallel.Gate
  alias Situ.Pipeline.Launcher

  @type built :: %{pid: pid(), output?: boolean(), immediate?: boolean()}
  @typedoc "A part for the branch, or a time at which it receives no part."
  @type entry :: {Situ.Time.t(), term()} | Situ.Time.t()

  @typedoc """
  Where and how to start: `timing` describes the surrounding pipeline: its clock, whether that clock is enforced, the
  start of the branch, the end of the replay, and the policy of the branch's connections.
  """
  @type place :: %{
          id: reference(),
          node: node(),
          path: String.t(),
          type: Situ.Type.t(),
          timing: map()
        }

  @doc "Builds and starts the branch of `fun`. Raises any error raised by building the branch."
  @spec start!((Stream.t() -> term()), place()) :: built()
  def start!(fun, %{id: id, timing: timing} = place) do
    to = self()
    replay = [interval: replay_interval(timing), speed: if(timing.enforce, do: 1.0, else: :max)]
    settings = [name: place.path, clock: timing.clock, replay: replay]
    settings = if timing.policy, do: [default_policy: timing.policy] ++ settings, else: settings

    case Launcher.start_with_reply(&build_branch(&1, fun, to, place), [pipeline: settings], id) do
      {:ok, pid} ->
        receive do
          {:situ_branch, ^id, {:built, built}} -> Map.put(built, :pid, pid)
        end

      {:error, %Error{} = error} ->
        raise error
    end
  end

  defp replay_interval(%{start: start, replay_end: :infinity}), do: {start, :unbounded}
  defp replay_interval(%{start: start, replay_end: time}), do: {start, max(start, time)}

  # The scope makes errors and processes inside carry the branch's name.
  defp build_branch(p, fun, to, %{id: id, path: path, type: type}) do
    p = %{p | scope: path}
    gate = Pipeline.add(p, Gate, to: to, id: id, name: "In", outputs: [out: type])
    result = fun.(Situ.Node.output(gate, :out))

    if is_struct(result, Stream) do
      report = fn data, message -> Gate.report_output(to, id, message.originating_time, data) end
      Operator.attach(result, "Out", {:each, report})
    end

    immediate? = Builder.update_graph(p, &merge_into_one_stage(&1, gate.id))
    built = %{output?: is_struct(result, Stream), immediate?: immediate?}
    send(to, {:situ_branch, id, {:built, built}})
  end

  # A chain of light operators shares the source's process, so the result of each part is known immediately.
  defp merge_into_one_stage(graph, gate) do
    edges =
      Map.new(graph.edges, fn
        {id, %{from: {^gate, _}, explicit: false} = edge} ->
          {id, %{edge | policy: Delivery.synchronous()}}

        other ->
          other
      end)

    tied = %{graph | edges: edges}

    case Plan.compile(tied) do
      {:ok, %{stages: [_one]}} -> {true, tied}
      _ -> {false, graph}
    end
  end
end
