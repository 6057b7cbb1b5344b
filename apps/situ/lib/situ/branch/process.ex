defmodule Situ.Branch.Process do
  @moduledoc false
  # A branch that runs as a separate pipeline with its own processes, and so may contain any component. It sends
  # these messages to the process that started it:
  #   {:situ_branch, id, {:open, pid}}                              the process that accepts its input
  #   {:situ_branch, id, {:outputs, [{time, data}], passed_time}}   outputs; if `passed_time` is a time, the branch has
  #                                                                 handled all input up to it (only sent by chains of
  #                                                                 light operators)
  #   {id, result}                                                  the branch has ended; no more output follows
  #
  # The branch ends with the process that started it.
  alias Situ.Graph.{Builder, Plan}
  alias Situ.{Delivery, Operator, Pipeline, Stream}
  alias Situ.Pipeline.Launcher

  defmodule Gate do
    @moduledoc false
    # The source of the branch. It emits the entries that it receives, as fast as the branch requests them.
    use Situ.Component,
      inputs: [],
      outputs: [out: :any],
      options: [to: [type: :pid, required: true], id: [type: :any, required: true]]

    defstruct [:to, :id, :since, queue: [], slice: 1, passed_time: nil, stopping: false]

    @quick_us 1_000
    @most 512

    @impl true
    def init(opts), do: {:ok, %__MODULE__{to: opts[:to], id: opts[:id]}}

    @impl true
    def handle_start(_context, gate) do
      Process.put({__MODULE__, gate.id}, [])
      send(gate.to, {:situ_branch, gate.id, {:open, self()}})
      {[], gate}
    end

    @impl true
    def handle_info({:situ_feed, entries}, _context, gate),
      do: {[], %{gate | queue: append_entries(gate.queue, collect_pending_entries(entries))}}

    def handle_info(_other, _context, gate), do: {[], gate}

    # Takes all entries that are already in the mailbox, in one time slice.
    defp collect_pending_entries(entries) do
      receive do
        {:situ_feed, more} -> collect_pending_entries(entries ++ more)
      after
        0 -> entries
      end
    end

    defp append_entries([], entries), do: entries
    defp append_entries(queue, entries), do: queue ++ entries

    @doc """
    Reports an output of the branch. An output emitted in this process is reported with the next `passed_time`. Any
    other output is reported immediately.
    """
    def report_output(to, id, time, data) do
      case Process.get({__MODULE__, id}) do
        nil -> send(to, {:situ_branch, id, {:outputs, [{time, data}], nil}})
        unreported -> Process.put({__MODULE__, id}, [{time, data} | unreported])
      end
    end

    # By now the operators in this process have handled the previous slice. If that was fast, the next slice is
    # larger. A slow branch gets small slices, so that its counters show progress.
    @impl true
    def handle_demand(n, _context, gate) do
      gate = gate |> report_passed() |> resize_slice()
      {actions, gate} = take_entries(min(n, gate.slice), gate, [])
      gate = if actions == [], do: report_passed(gate), else: gate
      since = if gate.queue != [], do: System.monotonic_time(:microsecond)
      {actions ++ stopped_actions(gate), %{gate | since: since}}
    end

    defp resize_slice(%{since: nil} = gate), do: gate

    defp resize_slice(gate) do
      if System.monotonic_time(:microsecond) - gate.since < @quick_us,
        do: %{gate | slice: min(2 * gate.slice, @most)},
        else: %{gate | slice: 1}
    end

    @impl true
    def handle_stop(_final, _context, gate) do
      if gate.queue == [] and gate.passed_time == nil,
        do: {[], gate},
        else: {[:stopping], %{gate | stopping: true}}
    end

    # Outputs emitted before a failure count.
    @impl true
    def terminate(_reason, gate), do: report_passed(gate)

    defp report_passed(%{passed_time: nil} = gate), do: gate

    defp report_passed(gate) do
      unreported = Process.put({__MODULE__, gate.id}, [])

      send(
        gate.to,
        {:situ_branch, gate.id, {:outputs, :lists.reverse(unreported), gate.passed_time}}
      )

      %{gate | passed_time: nil}
    end

    defp take_entries(n, gate, actions) do
      {queue, passed_time, actions} = collect_actions(n, gate.queue, gate.passed_time, actions)
      {:lists.reverse(actions), %{gate | queue: queue, passed_time: passed_time}}
    end

    defp collect_actions(0, queue, passed_time, actions), do: {queue, passed_time, actions}
    defp collect_actions(_n, [], passed_time, actions), do: {[], passed_time, actions}

    defp collect_actions(n, [{time, data} | rest], _passed, actions),
      do: collect_actions(n - 1, rest, time, [{:out, time, data} | actions])

    defp collect_actions(n, [time | rest], _passed, actions),
      do: collect_actions(n, rest, time, actions)

    # The source may stop only after the results of the last entries have been reported.
    defp stopped_actions(%{stopping: true, queue: [], passed_time: nil}), do: [:stopped]
    defp stopped_actions(_gate), do: []
  end

  @type built :: %{pid: pid(), output?: boolean(), immediate?: boolean()}

  @doc """
  Builds and starts the branch of `fun`, beginning at `timing.start`. `timing` describes the surrounding pipeline: its
  clock, whether that clock is enforced, and the end of the replay. Raises any error raised by building the branch.
  """
  @spec start_pipeline!((Stream.t() -> term()), reference(), String.t(), Situ.Type.t(), map()) ::
          built()
  def start_pipeline!(fun, id, path, type, timing) do
    to = self()
    replay = [interval: replay_interval(timing), speed: if(timing.enforce, do: 1.0, else: :max)]
    settings = [name: path, clock: timing.clock, replay: replay]
    settings = if timing[:policy], do: [default_policy: timing.policy] ++ settings, else: settings
    spec = fn p -> build_pipeline(p, fun, {to, id}, path, type) end

    case Launcher.start_with_reply(spec, [pipeline: settings], id) do
      {:ok, pid} ->
        receive do
          {:situ_branch, ^id, {:built, built}} -> Map.put(built, :pid, pid)
        end

      {:error, error} ->
        raise error
    end
  end

  @typedoc "A part for the branch, or a time at which it receives no part."
  @type entry :: {Situ.Time.t(), term()} | Situ.Time.t()

  @spec send_entries(pid(), [entry()]) :: term()
  def send_entries(gate, entries), do: send(gate, {:situ_feed, entries})

  @doc "Ends the branch at `time`, after it has handled all entries sent to it."
  @spec request_stop(pid(), Situ.Time.t()) :: term()
  def request_stop(pid, time), do: send(pid, {:situ_stop, time})

  defp replay_interval(%{start: start, replay_end: :infinity}), do: {start, :unbounded}
  defp replay_interval(%{start: start, replay_end: time}), do: {start, max(start, time)}

  # The scope makes errors and processes inside carry the branch's name.
  defp build_pipeline(p, fun, {to, id}, path, type) do
    p = %{p | scope: path}
    gate = Pipeline.add(p, Gate, to: to, id: id, name: "In", outputs: [out: type])
    result = fun.(Situ.Node.output(gate, :out))

    if is_struct(result, Stream) do
      tell = fn data, message -> Gate.report_output(to, id, message.originating_time, data) end
      Operator.attach(result, "Out", {:each, tell})
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
