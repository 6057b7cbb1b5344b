defmodule Situ.Branch.Process do
  @moduledoc false
  # A branch as a pipeline of its own: its own processes, any component inside. What it says to the process that started it:
  #
  #   {:situ_branch, id, {:open, pid}}          where its input is sent
  #   {:situ_branch, id, {:gave, time, data}}   something came out
  #   {:situ_branch, id, {:passed, time}}       all up to that time is dealt with (if it is a run of light operators)
  #   {id, result}                              it has ended; everything it gave came before
  #
  # It ends with the process that started it.
  alias Situ.Graph.{Builder, Plan}
  alias Situ.{Delivery, Message, Operator, Pipeline, Stream}
  alias Situ.Pipeline.Launcher

  defmodule Gate do
    @moduledoc false
    # Where the branch begins: hands on what it is sent, as fast as the branch asks for it.
    use Situ.Component,
      inputs: [],
      outputs: [out: :any],
      options: [to: [type: :pid, required: true], id: [type: :any, required: true]]

    defstruct [:to, :id, queue: :queue.new(), passed: nil, stopping: false]

    @impl true
    def init(opts), do: {:ok, %__MODULE__{to: opts[:to], id: opts[:id]}}

    @impl true
    def handle_start(_context, gate) do
      send(gate.to, {:situ_branch, gate.id, {:open, self()}})
      {[], gate}
    end

    @impl true
    def handle_info({:situ_feed, entry}, _context, gate),
      do: {[], %{gate | queue: waiting(:queue.in(entry, gate.queue))}}

    def handle_info(_other, _context, gate), do: {[], gate}

    # All that is there already, in one turn.
    defp waiting(queue) do
      receive do
        {:situ_feed, entry} -> waiting(:queue.in(entry, queue))
      after
        0 -> queue
      end
    end

    # What was emitted the time before has been through the operators that share this process.
    @impl true
    def handle_demand(n, _context, gate) do
      {actions, gate} = take(n, tell(gate), [])
      gate = if actions == [], do: tell(gate), else: gate
      {actions ++ over(gate), gate}
    end

    @impl true
    def handle_stop(_final, _context, gate) do
      if :queue.is_empty(gate.queue) and gate.passed == nil,
        do: {[], gate},
        else: {[:stopping], %{gate | stopping: true}}
    end

    defp tell(%{passed: nil} = gate), do: gate

    defp tell(gate) do
      send(gate.to, {:situ_branch, gate.id, {:passed, gate.passed}})
      %{gate | passed: nil}
    end

    defp take(0, gate, actions), do: {:lists.reverse(actions), gate}

    defp take(n, gate, actions) do
      case :queue.out(gate.queue) do
        {:empty, _} ->
          {:lists.reverse(actions), gate}

        {{:value, %Message{originating_time: time, data: data}}, queue} ->
          take(n - 1, %{gate | queue: queue, passed: time}, [{:out, time, data} | actions])

        {{:value, time}, queue} ->
          take(n, %{gate | queue: queue, passed: time}, actions)
      end
    end

    defp over(%{stopping: true, queue: queue}),
      do: if(:queue.is_empty(queue), do: [:stopped], else: [])

    defp over(_gate), do: []
  end

  @type built :: %{pid: pid(), output?: boolean(), immediate?: boolean()}

  @doc """
  Builds and starts the branch of `fun`. `timing` is the surrounding pipeline's: clock, whether it is waited for, and the replay's end; the
  branch begins at `start`. Raises what building raised.
  """
  @spec start!((Stream.t() -> term()), reference(), String.t(), Situ.Type.t(), map()) :: built()
  def start!(fun, id, path, type, timing) do
    to = self()
    replay = [interval: interval(timing), speed: if(timing.enforce, do: 1.0, else: :max)]
    settings = [name: path, clock: timing.clock, replay: replay]
    spec = fn p -> build(p, fun, {to, id}, path, type) end

    case Launcher.start_answering(spec, [pipeline: settings], id) do
      {:ok, pid} ->
        receive do
          {:situ_branch, ^id, {:built, built}} -> Map.put(built, :pid, pid)
        end

      {:error, error} ->
        raise error
    end
  end

  @doc "A part for the branch, or a time at which it gets none."
  @spec feed(pid(), Message.t() | Situ.Time.t()) :: term()
  def feed(gate, entry), do: send(gate, {:situ_feed, entry})

  @doc "The branch ends at `time`, after everything it was sent."
  @spec stop(pid(), Situ.Time.t()) :: term()
  def stop(pid, time), do: send(pid, {:situ_stop, time})

  defp interval(%{start: start, replay_end: :infinity}), do: {start, :unbounded}
  defp interval(%{start: start, replay_end: time}), do: {start, max(start, time)}

  # Errors and processes inside carry the branch's name.
  defp build(p, fun, {to, id}, path, type) do
    p = %{p | scope: path}
    gate = Pipeline.add(p, Gate, to: to, id: id, name: "In", outputs: [out: type])
    result = fun.(Situ.Node.output(gate, :out))

    if is_struct(result, Stream) do
      tell = fn data, message ->
        send(to, {:situ_branch, id, {:gave, message.originating_time, data}})
      end

      Operator.attach(result, "Out", {:each, tell})
    end

    immediate? = Builder.run(p, &together(&1, gate.id))
    built = %{output?: is_struct(result, Stream), immediate?: immediate?}
    send(to, {:situ_branch, id, {:built, built}})
  end

  # A run of light operators shares the gate's process: it is known at once what a part has led to.
  defp together(graph, gate) do
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
