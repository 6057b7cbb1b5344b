defmodule Situ.Bench.Calls do
  @moduledoc false
  # The calls of Situ's functions that a stage makes for one message that reaches it idle: for a
  # component, and for an operator with its own process. Counts do not depend on the machine.
  alias Situ.Pipeline

  defmodule Push do
    @moduledoc false
    # Emits the data of each `{:push, data}` that is sent to its process.
    use Situ.Component, outputs: [out: :integer], options: [owner: [type: :pid, required: true]]

    @impl true
    def init(opts), do: {:ok, opts[:owner]}

    @impl true
    def handle_start(_context, owner) do
      send(owner, {:source, self()})
      {[{:complete, :infinity}], owner}
    end

    @impl true
    def handle_info({:push, data}, context, owner), do: {[{:out, context.now, data}], owner}
    def handle_info(_other, _context, owner), do: {[], owner}
  end

  defmodule Pass do
    @moduledoc false
    use Situ.Component, inputs: [in: :integer], outputs: [out: :integer]

    @impl true
    def init(_opts), do: {:ok, nil}

    @impl true
    def handle_message(:in, message, _context, state),
      do: {[{:out, message.originating_time, message.data}], state}
  end

  def tests, do: [{"calls", &calls(max(round(20 * &1), 3))}]

  defp calls(n) do
    for {kind, stage} <- [
          component: &Situ.via(&1, Pass, name: "Stage"),
          operator: &Situ.map(&1, fn x -> x end, async: true, name: "Stage")
        ],
        metric <- count("calls_#{kind}", stage, n),
        do: metric
  end

  defp count(metric, stage, n) do
    test = self()

    {:ok, pipeline} =
      Pipeline.start(fn p ->
        p
        |> Situ.source(Push, owner: test)
        |> stage.()
        |> Situ.each(&send(test, {:arrived, &1}), async: true)
      end)

    source = receive do: ({:source, pid} -> pid)
    push(source, 0)
    calls = trace(stage_pid(pipeline), fn -> for i <- 1..n, do: push(source, i) end)
    {:ok, _} = Pipeline.stop(pipeline)
    if calls == [], do: raise("no call was seen")
    modules = calls |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> length()
    [{metric, length(calls) / n, "calls/msg"}, {metric <> "_modules", modules, "modules"}]
  end

  # The next message is sent when nothing is left to do.
  defp push(source, i) do
    send(source, {:push, i})
    receive do: ({:arrived, ^i} -> Process.sleep(20))
  end

  defp stage_pid(pipeline) do
    [pid] = for %{nodes: ["Stage"], pid: pid} <- Pipeline.info(pipeline).processes, do: pid
    "#PID" <> text = pid
    text |> String.to_charlist() |> :erlang.list_to_pid()
  end

  defp trace(pid, fun) do
    for app <- [:situ, :situ_types], module <- Application.spec(app, :modules) do
      Code.ensure_loaded!(module)
      :erlang.trace_pattern({module, :_, :_}, true, [:local])
    end

    :erlang.trace(pid, true, [:call])
    fun.()
    :erlang.trace(pid, false, [:call])
    :erlang.trace_pattern({:_, :_, :_}, false, [:local])
    collect([])
  end

  defp collect(calls) do
    receive do
      {:trace, _pid, :call, {module, function, args}} ->
        collect([{module, function, length(args)} | calls])
    after
      0 -> calls
    end
  end
end
