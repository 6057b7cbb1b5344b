defmodule Situ.Parallel.Gate do
  @moduledoc false
  # The source of a branch that is a pipeline. It emits the entries that it receives, as fast as the branch requests
  # them, and reports the outputs of the branch.
  use Situ.Component,
    inputs: [],
    outputs: [out: :any],
    options: [to: [type: :pid, required: true], id: [type: :any, required: true]]

  alias Situ.Runtime

  defstruct [:to, :id, :since, queue: [], slice: 1, passed_time: nil, stopping: false]

  @quick_ns 1_000_000
  @most 512

  @impl true
  def init(opts), do: {:ok, %__MODULE__{to: opts[:to], id: opts[:id]}}

  @impl true
  def handle_start(_context, gate) do
    Process.put({__MODULE__, gate.id}, [])
    send(self(), :situ_open)
    {[], gate}
  end

  # Until now, the stage was starting. It has kept its messages aside, so they could not be taken from the mailbox.
  @impl true
  def handle_info(:situ_open, context, gate) do
    send(gate.to, {:situ_branch, gate.id, {:open, self(), context.pipeline.pid}})
    {[], gate}
  end

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
    since = if gate.queue != [], do: Runtime.monotonic_time()
    {actions ++ stopped_actions(gate), %{gate | since: since}}
  end

  defp resize_slice(%{since: nil} = gate), do: gate

  defp resize_slice(gate) do
    if Runtime.monotonic_time() - gate.since < @quick_ns,
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

    outputs = {:outputs, :lists.reverse(unreported), gate.passed_time}
    send(gate.to, {:situ_branch, gate.id, outputs})
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
