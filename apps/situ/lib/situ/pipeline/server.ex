defmodule Situ.Pipeline.Server do
  @moduledoc false
  # The process of one pipeline: owner of its life cycle, parent of its stages. Only this process decides what comes next.
  #
  #   building -> starting (all stages up, then all started) -> running -> stopping (sources stop, outputs close in order,
  #   stages quit) -> completed
  #
  #   caller/supervisor
  #     └── Server (traps exits)
  #           ├── Stage 1   linked: when a stage dies, the server decides by `on_error`;
  #           └── Stage n   when the server dies, its stages release what they hold and end
  use GenServer

  require Logger

  alias Situ.{Clock, Error}
  alias Situ.Graph.Builder

  alias Situ.Pipeline.{
    Archive,
    Death,
    Ending,
    Inputs,
    Launch,
    Life,
    Notice,
    Part,
    Taps,
    View,
    Watch
  }

  @impl true
  def init(_), do: :ignore

  @impl true
  def handle_call(request, from, state), do: guard(state, fn -> answer(request, from, state) end)

  @impl true
  def handle_info(message, state), do: guard(state, fn -> event(message, state) end)

  # A step that fails half way leaves a state that nothing can be ended by in order: the pipeline ends with an error at once,
  # and its components release what they hold.
  defp guard(state, step) do
    step.()
  catch
    kind, reason ->
      Logger.error(Exception.format(kind, reason, __STACKTRACE__))
      error = Launch.crashed({kind, reason, __STACKTRACE__})
      over({:error, %{error | meta: %{errors: [error]}}}, %{state | phase: :completed})
  end

  defp answer({:build, change}, _from, %{phase: :building} = state) do
    {:reply, {:ok, Builder.run(state.handle, change)}, state}
  rescue
    error in Error -> {:reply, {:error, error}, state}
  end

  defp answer({:build, _change}, _from, state),
    do: {:reply, {:error, Builder.running()}, state}

  defp answer(:start, _from, %{phase: :building} = state) do
    graph = Builder.close(state.handle)
    {:reply, :ok, Life.launch(%{state | graph: graph, phase: :starting})}
  end

  defp answer(:start, _from, state), do: {:reply, {:error, Builder.running()}, state}

  defp answer({:stop, catch_up}, from, state),
    do: done(Life.stop(%{state | waiters: [from | state.waiters], catch_up: catch_up}))

  defp answer(:await, from, state), do: {:noreply, %{state | waiters: [from | state.waiters]}}
  defp answer(:state, _from, state), do: {:reply, state.phase, state}

  defp answer(:clock, from, %{phase: :starting, clock: nil} = state),
    do: {:noreply, %{state | early: [{:"$gen_call", from, :clock} | state.early]}}

  defp answer(:clock, _from, state), do: {:reply, state.clock || Clock.real(), state}

  # For pipelines inside of this one's components.
  defp answer(:timing, _from, state),
    do: {:reply, Map.take(state, [:clock, :enforce, :replay_end]), state}

  defp answer(:mark, _from, state), do: {:reply, Watch.mark(state), state}

  defp answer(:quiet?, _from, state),
    do: {:reply, state.phase == :running and Ending.quiet?(state), state}

  defp answer(:info, _from, state) do
    snapshot = View.snapshot(state)
    {:reply, snapshot, state |> View.mark() |> View.describe()}
  end

  # A pipeline that is just starting answers when it runs.
  defp answer(request, from, %{phase: :starting} = state)
       when is_tuple(request) and
              elem(request, 0) in [
                :subscription,
                :replace,
                :tap,
                :stop_part,
                :clock,
                :attach,
                :detach
              ],
       do: {:noreply, %{state | early: [{:"$gen_call", from, request} | state.early]}}

  defp answer({:tap, which, fun, opts}, from, state),
    do: later(Taps.attach(state, which, fun, opts, from))

  defp answer({:attach, asked}, from, state), do: later(Inputs.attach(state, asked, from))

  defp answer({:detach, taker, request}, from, state),
    do: later(Inputs.detach(state, taker, request, from))

  defp answer({:untap, id}, _from, state), do: {:reply, :ok, Taps.detach(state, id)}

  defp answer({:stop_part, path, catch_up}, from, state) do
    case Part.stop(state, path, catch_up, from) do
      {:ok, state} -> done(state)
      {error, state} -> {:reply, error, state}
    end
  end

  defp answer({:subscription, which}, _from, state),
    do: {:reply, Taps.subscription(state, which), state}

  defp answer(:progress, _from, state) do
    state = View.advance_progress(state)
    {:reply, state.progress, state}
  end

  defp answer({:clock, _}, _from, %{clock: nil} = state),
    do: {:reply, {:error, Launch.not_running()}, state}

  defp answer({:clock, :pause}, _from, state), do: {:reply, Clock.pause(state.clock), state}
  defp answer({:clock, :resume}, _from, state), do: {:reply, Clock.resume(state.clock), state}

  defp answer({:clock, {:set_speed, speed}}, _from, state),
    do: {:reply, Clock.set_speed(state.clock, speed), state}

  defp answer({:replace, node, change}, from, state) do
    case Launch.replacement(state, node, change) do
      {:ok, stage, request} ->
        send(state.stages[stage].pid, {:situ, request})
        {:noreply, %{state | replacing: Map.put(state.replacing, stage, {from, request})}}

      {:error, error} ->
        {:reply, {:error, error}, state}
    end
  end

  defp answer(_request, _from, state), do: {:reply, {:error, Launch.not_running()}, state}

  # Who asked is answered when it is done, or at once when it cannot be.
  defp later({:ok, state}), do: {:noreply, state}
  defp later({error, state}), do: {:reply, error, state}

  defp event(:situ_launch, state), do: done(Life.launch(state))
  defp event({:situ_stage, id, event}, state), do: done(Life.event(state, id, event))
  defp event(:situ_stop, state), do: done(Life.stop(state))
  defp event({:situ_stop, time}, state), do: done(Life.stop(state, time))
  defp event(:situ_observe, state), do: {:noreply, View.observe(state)}
  defp event({:situ_part_enough, ref}, state), do: done(Part.enough(state, ref))
  defp event({:situ_part_stuck, ref, mark}, state), do: done(Part.stuck(state, ref, mark))

  defp event({:situ_stop_part, path, catch_up}, state),
    do: state |> Part.stop(path, catch_up, nil) |> elem(1) |> done()

  defp event(:situ_moving, state), do: {:noreply, %{state | moves: state.moves + 1}}
  defp event(:situ_recheck, state), do: done(Ending.recheck(state))
  defp event(:situ_enough, state), do: done(Ending.enough(state))
  defp event({:situ_stuck, mark}, state), do: done(Watch.stuck(state, mark))
  defp event({:EXIT, pid, reason}, state), do: done(Death.exited(state, pid, reason))

  defp event({:situ_clock, _}, state) do
    for {_, stage} <- state.stages, do: send(stage.pid, {:situ, :clock})
    {:noreply, state}
  end

  defp event({:DOWN, owner, :process, _, _}, %{owner: owner} = state),
    do: done(stop(state))

  defp event({:DOWN, ref, :process, _, _}, state),
    do: {:noreply, Taps.owner_down(state, ref)}

  defp event(_other, state), do: {:noreply, state}

  defp done(%{phase: :completed} = state), do: over(View.result(state), state)
  defp done(state), do: {:noreply, state}

  defp over(result, state) do
    publish(state.settings, result)
    Enum.each(state.waiters, &GenServer.reply(&1, result))
    for {_, %{from: from}} when from != nil <- state.parts, do: GenServer.reply(from, :ok)
    state = %{state | waiters: [], parts: %{}}

    case {result, state.settings.mode} do
      {{:error, error}, :linked} -> fall(error)
      {{:error, %{code: :crashed}}, _} -> {:stop, {:shutdown, :crashed}, state}
      _ -> {:stop, :normal, state}
    end
  end

  # Abnormal, so that a supervisor restarts it; by a signal, since the error itself is in the log already.
  defp fall(error) do
    Process.flag(:trap_exit, false)
    Process.exit(self(), {:pipeline_failed, error.code, error.what})
  end

  defp publish(%{mode: :run, reply: {caller, reply}}, result), do: send(caller, {reply, result})
  defp publish(_settings, result), do: Archive.put(self(), result)

  # A crash report names the pipeline; its graph has no place in a log.
  @impl true
  def format_status(_reason, [_dictionary, state]),
    do: [
      data: [{~c"State", %{pipeline: state.settings.name, phase: state.phase, step: state.step}}]
    ]

  # The parent asks us to go (a supervisor shutting down): stop as by hand, within the time it gives.
  @impl true
  def terminate(_reason, %{phase: :completed}), do: :ok

  def terminate(_reason, %{phase: :building} = state), do: Notice.abandoned(state.handle, nil)
  def terminate(_reason, state), do: state |> stop() |> shut()

  # What was built but not yet begun need not be begun to be stopped.
  defp stop(%{phase: :starting, plan: nil} = state), do: Ending.complete(state)
  defp stop(state), do: Life.stop(state)

  defp shut(%{phase: :completed} = state) do
    Archive.put(self(), View.result(state))
    Enum.each(state.waiters, &GenServer.reply(&1, View.result(state)))
  end

  defp shut(state) do
    receive do
      {:"$gen_call", from, request} when request == :await or elem(request, 0) == :stop ->
        shut(%{state | waiters: [from | state.waiters]})

      {:"$gen_call", from, _} ->
        GenServer.reply(from, {:error, Launch.not_running()})
        shut(state)

      message ->
        case handle_info(message, state) do
          {:noreply, state} -> shut(state)
          {:stop, _, _} -> :ok
        end
    end
  end
end
