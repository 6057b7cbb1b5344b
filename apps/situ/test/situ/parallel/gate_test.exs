defmodule Situ.Parallel.GateTest do
  use ExUnit.Case, async: true

  alias Situ.Parallel.{Component, Gate}

  @moduletag :capture_log

  defmodule Push do
    # Emits what the test sends to it.
    use Situ.Component, outputs: [out: :list], options: [to: [type: :pid, required: true]]

    @impl true
    def init(opts), do: {:ok, opts[:to]}

    @impl true
    def handle_start(_context, to) do
      send(to, {:push, self()})
      {[], to}
    end

    @impl true
    def handle_info({:emit, time, data}, _context, to), do: {[{:out, time, data}], to}
  end

  defmodule SlowStart do
    # Keeps its pipeline from running until the test says so.
    use Situ.Component,
      inputs: [in: :any],
      outputs: [out: :any],
      options: [to: [type: :pid, required: true]]

    @impl true
    def init(opts), do: {:ok, opts[:to]}

    @impl true
    def handle_start(context, to) do
      send(to, {:starting, self(), context.pipeline.pid})
      receive do: (:go -> {[], to})
    end

    @impl true
    def handle_message(:in, message, _context, to),
      do: {[{:out, message.originating_time, message.data}], to}
  end

  test "parts that arrive while a branch is starting are handled in order" do
    me = self()

    build = fn p ->
      p
      |> Situ.source(Push, to: me)
      |> Situ.parallel(&Situ.via(&1, SlowStart, to: me), size: 1, branches: :processes)
      |> Situ.each(&send(me, {:out, &1}))
    end

    {:ok, pipeline} = Situ.Pipeline.start(build)
    assert_receive {:push, push}
    emit(push, 1)
    assert_receive {:starting, slow, branch}
    gate = find_stage(branch, Gate)
    stages = [push, find_stage(pipeline, Component), gate]
    emit(push, 2)
    sync(stages)
    emit(push, 3)
    sync(stages)

    # The signal to run and the fourth part wait in the gate's mailbox together.
    :sys.suspend(gate)
    send(slow, :go)
    await_signal(gate)
    emit(push, 4)
    sync(stages -- [gate])
    :sys.resume(gate)
    for n <- 1..4, do: assert_receive({:out, [^n]})
    Situ.Pipeline.stop(pipeline)
  end

  defp emit(push, n), do: send(push, {:emit, n, [n]})

  # Two rounds, because a message may lead to another one in the same process.
  defp sync(pids), do: for(pid <- pids ++ pids, do: :sys.get_state(pid))

  defp await_signal(gate) do
    case Process.info(gate, :message_queue_len) do
      {:message_queue_len, 0} -> await_signal(gate)
      _ -> :ok
    end
  end

  defp find_stage(pipeline, module) do
    {:links, links} = Process.info(pipeline, :links)

    Enum.find(links, fn pid ->
      is_pid(pid) and Process.info(pid, :current_function) != nil and
        match?(%Situ.Stage.State{steps: {%{worker: %{module: ^module}}}}, state_of(pid))
    end)
  end

  # The slow component cannot report its state yet.
  defp state_of(pid) do
    :sys.get_state(pid, 500)
  catch
    :exit, _busy -> nil
  end
end
