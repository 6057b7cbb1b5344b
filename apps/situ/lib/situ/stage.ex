defmodule Situ.Stage do
  @moduledoc false
  # The process of one component, or of one chain of light operators: mailbox, demand, clock alarms. It owns no rule of its
  # own: posting rules are in Outlet, queues in Inlet, callbacks in Call, operators in Chain.
  #
  # It speaks GenStage's messages with its neighbours (see Situ.GenStage), `{:situ, request}` from its pipeline's server
  # and `{:situ_stage, id, event}` to it.
  use GenServer

  alias Situ.Clock
  alias Situ.Component.Context
  alias Situ.Stage.{Actions, Call, Inlet, Outlet, Tally}

  @never 9_000_000_000_000_000_000
  @slice_ns 5_000_000
  @hold_ms 20
  @flush_ns 200_000
  @pull 1_000
  @strikes 10

  defstruct [
    :id,
    :server,
    :kind,
    :vertices,
    :head,
    :module,
    :opts,
    :core,
    :chain,
    :tail,
    :fast,
    :clock,
    :control,
    :context,
    :tally,
    :alarm,
    :stopping,
    :completing,
    :final,
    enforce: false,
    phase: :starting,
    source: nil,
    completed: false,
    idle: false,
    failed: false,
    lossy: false,
    batch: false,
    scheduled: false,
    slice: 16,
    timers: [],
    probes: [],
    early: [],
    quitting: false,
    strikes: 0,
    inlets: %{},
    outlets: %{}
  ]

  @type t :: %__MODULE__{}

  @doc "No final time yet: what the control cell holds until the pipeline stops."
  @spec never() :: integer()
  def never, do: @never

  @doc "Starts the process; it reports `:up` or `{:down, error}` to the server by itself."
  @spec spawn_link(map()) :: pid()
  def spawn_link(args),
    do: :proc_lib.spawn_opt(__MODULE__, :init_it, [args], [:link, fullsweep_after: 30])

  @doc false
  def init_it(args) do
    Process.flag(:trap_exit, true)
    Process.put(:situ_pipeline, args.server)
    state = Situ.Stage.Setup.state(args)

    case Situ.Stage.Setup.core(state) do
      {:ok, state} ->
        report(state, :up)
        :gen_server.enter_loop(__MODULE__, [], state)

      {:error, error} ->
        report(state, {:init_failed, error})
        exit(:normal)
    end
  end

  @impl true
  def init(_), do: :ignore

  @impl true
  def handle_info({:"$gen_consumer", {_, tag}, batch} = message, state) when is_list(batch) do
    case state.inlets do
      %{^tag => inlet} -> {:noreply, pump(put_inlet(state, tag, Inlet.push(inlet, batch)))}
      _ -> {:noreply, foreign(state, message)}
    end
  end

  def handle_info({:"$gen_producer", {_pid, tag}, {:ask, n}}, state),
    do: state |> asked(tag, n) |> pump() |> unless_over()

  def handle_info({:"$gen_consumer", {_, tag}, {:cancel, reason}} = message, state) do
    case state.inlets do
      %{^tag => inlet} -> {:noreply, pump(put_inlet(state, tag, closing(inlet, reason, state)))}
      _ -> {:noreply, foreign(state, message)}
    end
  end

  def handle_info({:"$gen_producer", from, {:subscribe, _cancel, opts}}, state),
    do: {:noreply, subscribe(state, from, opts)}

  def handle_info({:"$gen_producer", {pid, tag}, {:cancel, reason}}, state) do
    send(pid, {:"$gen_consumer", {self(), tag}, {:cancel, reason}})
    state |> unsubscribe(&(&1.tag == tag and &1.pid == pid)) |> pump() |> unless_over()
  end

  def handle_info(:situ_pump, state), do: {:noreply, pump(%{state | scheduled: false})}
  def handle_info({:situ_alarm, _}, state), do: {:noreply, alarm(%{state | alarm: nil})}
  def handle_info({:situ, request}, state), do: request(request, state)

  # A hold that was renewed or ended meanwhile is not this one's to end.
  def handle_info({:situ_hold, tag, token}, state) do
    case state.inlets do
      %{^tag => %{held: {_timer, ^token}} = inlet} ->
        state = put_inlet(state, tag, %{inlet | held: nil})
        {:noreply, foreign(state, {:hold_ended, inlet.name})}

      _ ->
        {:noreply, state}
    end
  end

  def handle_info({:DOWN, ref, :process, pid, _} = message, state) do
    if Enum.any?(state.outlets, fn {_, o} -> Enum.any?(o.subs, &(&1[:monitor] == ref)) end),
      do:
        state |> unsubscribe(&(&1.pid == pid and &1[:monitor] == ref)) |> pump() |> unless_over(),
      else: {:noreply, foreign(state, message)}
  end

  def handle_info({:EXIT, _pid, :normal}, state), do: {:noreply, state}
  def handle_info(message, state), do: {:noreply, foreign(state, message)}

  @impl true
  def terminate(_reason, %{kind: :chain}), do: :ok

  def terminate(reason, state),
    do: Call.terminate(state.module, reason, state.core, state.head.path)

  defp unless_over(%{quitting: true} = state) do
    if drained?(state), do: {:stop, :normal, state}, else: {:noreply, state}
  end

  defp unless_over(state), do: {:noreply, state}

  defp drained?(state), do: Enum.all?(state.outlets, fn {_, outlet} -> outlet.subs == [] end)

  # A crash report names the component; payloads and options have no place in a log.
  @impl true
  def format_status(_reason, [_dictionary, state]), do: [data: [{'State', summary(state)}]]

  defp summary(%__MODULE__{} = state),
    do: %{component: state.head.path, phase: state.phase, inputs: map_size(state.inlets)}

  defp summary(_state), do: %{}

  # Requests of the server

  defp request({:start, wiring}, state) do
    state = Situ.Stage.Setup.wire(state, wiring)
    state.early |> Enum.reverse() |> Enum.each(&send(self(), &1))
    state = %{state | early: []}

    state =
      if state.kind == :component,
        do: call(state, :handle_start, [state.context], nil),
        else: state

    report(state, :started)
    {:noreply, state}
  end

  defp request(:run, state) do
    Enum.each(state.inlets, fn {_, inlet} -> send_ask(inlet, first_demand(inlet)) end)
    {:noreply, pump(arm(%{state | phase: :running}))}
  end

  defp request({:ask, tag}, state) do
    with %{^tag => inlet} <- state.inlets, do: send_ask(inlet, first_demand(inlet))
    {:noreply, state}
  end

  defp request({:stop, final}, state), do: {:noreply, state |> stop_source(final) |> pump()}

  defp request(:stop_now, %{stopping: :done} = state), do: {:noreply, state}

  defp request(:stop_now, state) do
    state = each_outlet(state, &%{&1 | future: [], future_rear: []})
    {:noreply, stopped(%{state | stopping: :stopping})}
  end

  defp request({:finalize, time}, state) do
    state = settle(each_outlet(settle(state), &Outlet.close(&1, time)))
    Situ.Stage.Probe.close(state, time)
    report(state, :finalized)
    {:noreply, arm(state)}
  end

  # Subscribers from outside the pipeline still get what they have coming, at their own pace.
  defp request(:quit, state) do
    state = each_outlet(settle(state), &Outlet.close(&1, state.final || 0))
    if drained?(state), do: {:stop, :normal, state}, else: {:noreply, %{state | quitting: true}}
  end

  defp request({:tap, tag, output, index, pid, counters}, state) do
    state = tap(state, tag, {output, index}, pid, counters)
    report(state, {:tapped, tag})
    {:noreply, state}
  end

  defp request({:untap, tag}, state) do
    state = unsubscribe(state, &(&1.tag == tag))
    {:noreply, state |> Situ.Stage.Probe.remove(tag) |> pump()}
  end

  defp request({:fail, error}, state), do: {:noreply, pump(fail(state, error))}
  defp request(:clock, state), do: {:noreply, state |> arm() |> pump()}
  defp request({:peer, tag, pid}, state), do: {:noreply, Situ.Stage.Setup.rewire(state, tag, pid)}

  defp request({:peer_gone, tag, time}, state) do
    case state.inlets do
      %{^tag => inlet} ->
        {:noreply, pump(put_inlet(state, tag, Inlet.push_closed(inlet, time)))}

      _ ->
        {:noreply, state |> unsubscribe(&(&1.tag == tag)) |> pump()}
    end
  end

  defp request({:replace, index, module, opts}, state) do
    case Situ.Stage.Setup.replace(state, index, module, opts) do
      {:ok, state, actions} ->
        report(state, {:replaced, :ok})
        {:noreply, state |> act(state.core, actions, nil) |> pump()}

      {:error, error} ->
        report(state, {:replaced, {:error, error}})
        {:noreply, state}
    end
  end

  defp request(:describe, state) do
    report(state, {:description, Situ.Stage.Setup.describe(state)})
    {:noreply, state}
  end

  defp tap(state, tag, {output, nil}, pid, counters) do
    {:ok, outlet} = Situ.Stage.Setup.find_outlet(state, output: output)
    sub = %{Outlet.sub(tag, pid, counters) | demand: :infinity}
    put_outlet(state, Outlet.subscribe(outlet, sub))
  end

  defp tap(state, tag, {_output, index}, pid, counters) do
    state = Situ.Stage.Probe.add(state, tag, index, pid, counters)
    ended = for {_, %{closing: time}} <- state.outlets, time != nil, do: time
    if ended != [], do: Situ.Stage.Probe.close(state, hd(ended))
    state
  end

  # Taking messages

  defp pump(%{phase: :running, failed: false, kind: :chain} = state) do
    now = Clock.now(state.clock)
    final = :atomics.get(state.control, 1)
    chain(state, now, now + @slice_ns, final)
  end

  defp pump(%{phase: :running, failed: false} = state) do
    now = Clock.now(state.clock)
    final = :atomics.get(state.control, 1)
    state |> take(now, {now, now + @slice_ns}, final) |> arm()
  end

  defp pump(%{phase: :running} = state), do: discard(state)
  defp pump(state), do: state

  # A component: one message at a time, the earliest among its inputs first.
  defp take(state, now, {_from, till} = times, final) do
    state = if state.lossy, do: drain_mailbox(state), else: state

    cond do
      now > till -> schedule(settle(state))
      room(state) < 1 -> blocked(state, now, times, final)
      true -> take_next(state, now, times, final)
    end
  end

  defp blocked(state, now, times, final) do
    state = settle(state)
    if room(state) < 1, do: state, else: take_next(state, now, times, final)
  end

  defp take_next(state, now, times, final) do
    case earliest(state.inlets) do
      nil ->
        produce(settle(state), now, final)

      {tag, %{lossy: false, check: :off} = inlet} when state.batch ->
        {state, now} = take_batch(state, tag, inlet, now, final)
        next(state, now, times, final)

      {tag, inlet} ->
        {state, now} = take_one(state, tag, inlet, now, final)
        next(state, now, times, final)
    end
  end

  defp take_one(state, tag, inlet, now, final) do
    {entry, inlet} = Inlet.pop(inlet, now)
    entry(entry, state, tag, inlet, now, final)
  end

  # Components with `handle_messages/4` get what waits at once, as far as it is in time and there is room.
  defp take_batch(state, tag, inlet, now, final) do
    room = min(room(state), state.slice)

    case Inlet.take(inlet, room) do
      {[_, _ | _] = messages, rest} -> try_batch(state, tag, inlet, {messages, rest}, now, final)
      _ -> take_one(state, tag, inlet, now, final)
    end
  end

  defp try_batch(state, tag, inlet, {messages, rest}, now, final) do
    last = List.last(messages).originating_time

    with true <- last <= final,
         context = %{state.context | now: now},
         {:ok, actions, core} <-
           Call.messages(state.module, inlet.name, messages, context, state.core),
         {:ok, state} <- Actions.run(%{state | core: core}, actions, now) do
      after_time = Clock.now(state.clock)
      n = length(messages)
      # Whether it is held is for the component to say, and it may just have said so.
      rest = %{rest | held: Map.fetch!(state.inlets, tag).held}
      rest = Inlet.handled(rest, n, last, {now, after_time - now})
      {state |> put_inlet(tag, rest) |> resize(n, after_time - now), after_time}
    else
      _ -> one_by_one(state, tag, inlet, now, final, length(messages))
    end
  end

  # All of the failed batch, before another batch is tried.
  defp one_by_one(%{failed: true} = state, _tag, _inlet, now, _final, _n), do: {state, now}
  defp one_by_one(state, _tag, _inlet, now, _final, 0), do: {state, now}

  defp one_by_one(state, tag, inlet, now, final, n) do
    {state, now} = take_one(state, tag, inlet, now, final)
    one_by_one(state, tag, Map.fetch!(state.inlets, tag), now, final, n - 1)
  end

  defp next(%{failed: true} = state, _now, _times, _final), do: discard(state)

  defp next(state, now, {from, till}, final) do
    if now - from > @flush_ns,
      do: take(settle(state), now, {now, till}, final),
      else: take(state, now, {from, till}, final)
  end

  defp entry(nil, state, tag, inlet, now, _final), do: {put_inlet(state, tag, inlet), now}

  defp entry({:closed, time}, state, tag, inlet, now, _final) do
    {closed_input(settle(put_inlet(state, tag, inlet)), tag, inlet, time), now}
  end

  defp entry(%{originating_time: time}, state, tag, inlet, now, final) when time > final do
    Inlet.drop(inlet, 1)
    {put_inlet(state, tag, %{inlet | owed: inlet.owed + owed(inlet)}), now}
  end

  defp entry(message, state, tag, inlet, now, _final) do
    state = handle(state, tag, inlet, message, now)
    after_time = Clock.now(state.clock)
    inlet = Map.get(state.inlets, tag, inlet)
    inlet = Inlet.handled(inlet, 1, message.originating_time, {now, after_time - now})
    {put_inlet(state, tag, inlet), after_time}
  end

  defp handle(state, tag, inlet, message, now) do
    path = state.head.path

    with {:ok, inlet} <- Inlet.check(inlet, message, path),
         context = %{state.context | now: now},
         {:ok, actions, core} <-
           Call.message(state.module, inlet.name, message, context, state.core, path),
         state = put_inlet(state, tag, inlet),
         {:ok, state} <- Actions.run(%{state | core: core}, actions, now) do
      state
    else
      {:error, error} -> wrong(put_inlet(state, tag, inlet), Call.at(error, inlet.name, message))
    end
  end

  defp closed_input(state, tag, inlet, time) do
    state = %{state | inlets: Map.delete(state.inlets, tag)}

    state =
      if state.kind == :component and not state.failed,
        do: call(state, :handle_closed, [inlet.name, time, state.context], nil),
        else: state

    state = settle(state)
    report(state, {:unsubscribed, tag, inlet.name, time})
    state
  end

  # A chain: as many messages at once as there is room for; slices grow while they are quick.
  defp chain(%{inlets: inlets} = state, _now, _till, _final) when map_size(inlets) == 0,
    do: settle(state)

  defp chain(state, now, till, final) do
    state = if state.lossy, do: drain_mailbox(state), else: state
    [{tag, inlet}] = Map.to_list(state.inlets)
    [{_, outlet}] = Map.to_list(state.outlets)

    case chain_take(inlet, Outlet.room(outlet), state.slice, now) do
      {[], inlet} ->
        settle(put_inlet(state, tag, inlet))

      {:closed, time, inlet} ->
        closed_chain(state, tag, inlet, time)

      {messages, inlet} ->
        chain_run(put_inlet(state, tag, inlet), tag, messages, {now, till, final})
    end
  end

  defp closed_chain(state, tag, inlet, time), do: closed_input(settle(state), tag, inlet, time)

  defp chain_take(inlet, room, _slice, _now) when is_integer(room) and room < 1, do: {[], inlet}

  defp chain_take(%{lossy: true} = inlet, _room, _slice, now) do
    case Inlet.pop(inlet, now) do
      {nil, inlet} -> {[], inlet}
      {{:closed, time}, inlet} -> {:closed, time, inlet}
      {message, inlet} -> {[message], inlet}
    end
  end

  defp chain_take(inlet, room, slice, now) do
    case Inlet.take(inlet, min(room, slice)) do
      {[], %{front: [{:closed, time} | _]} = inlet} ->
        {:closed, time, elem(Inlet.pop(inlet, now), 1)}

      {messages, inlet} ->
        {messages, inlet}
    end
  end

  defp chain_run(state, tag, messages, {now, till, final}) do
    {state, last, n} = Situ.Stage.Run.batch(state, messages, now, final)
    after_time = Clock.now(state.clock)
    inlet = Map.fetch!(state.inlets, tag)
    inlet = if n > 0, do: Inlet.handled(inlet, n, last, {now, after_time - now}), else: inlet
    state = state |> put_inlet(tag, inlet) |> resize(n, after_time - now)

    cond do
      state.failed -> discard(settle(state))
      after_time > till -> schedule(settle(state))
      n >= 64 and after_time - now < @flush_ns -> chain(state, after_time, till, final)
      true -> chain(settle(state), after_time, till, final)
    end
  end

  defp resize(%{slice: slice} = state, n, elapsed) do
    cond do
      elapsed > 1_000_000 and slice > 1 -> %{state | slice: div(slice, 2)}
      elapsed < 100_000 and n == slice and slice < 512 -> %{state | slice: slice * 2}
      true -> state
    end
  end

  # A pull source: asked while there is room, no further than the clock when that is enforced.
  defp produce(
         %{source: :pull, completed: false, idle: false, stopping: stopping} = state,
         now,
         _final
       )
       when stopping in [nil, :stopping] do
    room = min(room(state), @pull)
    room = if state.enforce, do: min(room, 8), else: room
    room = if state.tail, do: min(room, state.slice), else: room

    if room < 1 or holding?(state) do
      state
    else
      before = {emitted(state), Tally.read(state.tally, 0).errors}
      state = call(state, :handle_demand, [room, %{state.context | now: now}], now)
      state = settle(judge(state, before))
      state = if state.tail, do: resize(state, room, Clock.now(state.clock) - now), else: state
      if state.idle or state.completed or state.failed, do: state, else: schedule(state)
    end
  end

  defp produce(state, _now, _final), do: state

  # A source that has nothing now is asked again when something happens; one that raised is asked again at once, with
  # `:skip` and `:restart`, but not for ever: there is no message that would be used up by the next try.
  defp judge(%{failed: true} = state, _before), do: state

  defp judge(state, {emitted, errors}) do
    cond do
      emitted(state) != emitted -> %{state | strikes: 0}
      Tally.read(state.tally, 0).errors == errors -> %{state | idle: true}
      state.strikes < @strikes -> %{state | strikes: state.strikes + 1}
      true -> fail(state, no_way_on(state))
    end
  end

  defp no_way_on(state) do
    Situ.Error.new(
      :no_way_on,
      "#{state.head.path} failed #{@strikes + 1} times without emitting anything",
      why: "a source that raises has no message to skip: it meets the same error again",
      fix: "handle the error in handle_demand/3, or use on_error: :stop",
      meta: %{component: state.head.path}
    )
  end

  defp emitted(state), do: Enum.map(state.outlets, fn {_, o} -> {o.seq, o.last_time} end)
  defp holding?(state), do: Enum.any?(state.outlets, fn {_, o} -> o.future != [] end)

  # Everything a component may say about itself

  defp call(state, callback, args, now) do
    case Call.run(state.module, callback, args ++ [state.core], state.head.path) do
      {:ok, actions, core} -> act(state, core, actions, now)
      {:error, error} -> wrong(state, error)
    end
  end

  # An action that is wrong takes the new state back, too.
  defp act(state, core, actions, now) do
    case Actions.run(%{state | core: core}, actions, now || Clock.now(state.clock)) do
      {:ok, state} -> arm(settle(state))
      {:error, error} -> wrong(state, error)
    end
  end

  # A neighbour that started sooner may have closed already: its word waits until this stage knows its neighbours too.
  defp foreign(%{clock: nil} = state, message), do: %{state | early: [message | state.early]}

  defp foreign(%{kind: :component, failed: false} = state, message) do
    now = Clock.now(state.clock)

    %{state | idle: false}
    |> call(:handle_info, [message, %{state.context | now: now}], now)
    |> pump()
  end

  defp foreign(state, _message), do: state

  # Errors

  @doc false
  def wrong(%{phase: :starting} = state, error), do: fail(state, error)

  def wrong(state, error) do
    case state.head.on_error do
      :stop -> fail(state, error)
      :skip -> skip(state, error)
      :restart -> restart(state, error)
    end
  end

  defp skip(state, error) do
    Tally.skipped(state.tally, 0)
    report(state, {:skipped, error})
    state
  end

  defp restart(state, error) do
    Tally.restarted(state.tally, 0)
    report(state, {:skipped, error})
    Call.terminate(state.module, error, state.core, state.head.path)

    case Call.init(state.module, state.opts, state.head.path) do
      {:ok, core} ->
        state = %{state | core: core, timers: []}

        case Call.run(state.module, :handle_start, [state.context, core], state.head.path) do
          {:ok, actions, core} -> restarted(%{state | core: core}, actions)
          {:error, error} -> fail(state, error)
        end

      {:error, error} ->
        fail(state, error)
    end
  end

  defp restarted(state, actions) do
    case Actions.run(state, actions, Clock.now(state.clock)) do
      {:ok, state} -> state
      {:error, error} -> fail(state, error)
    end
  end

  @doc false
  def fail(%{failed: true} = state, _error), do: state

  def fail(state, error) do
    Tally.failed(state.tally, 0)
    report(state, {:failed, error})
    state = %{state | failed: true, timers: []}
    if state.stopping in [nil, :done], do: state, else: stopped(state)
  end

  defp discard(state) do
    state =
      Enum.reduce(state.inlets, state, fn {tag, inlet}, state ->
        {messages, closed} = split_closed(inlet)
        Inlet.drop(inlet, length(messages))

        inlet = %{
          inlet
          | front: [],
            rear: [],
            queue: inlet.lossy && Situ.Delivery.Queue.new(inlet.policy)
        }

        inlet = %{inlet | owed: inlet.owed + if(inlet.lossy, do: 0, else: length(messages))}
        state = put_inlet(state, tag, inlet)
        if closed, do: closed_input(state, tag, inlet, closed), else: state
      end)

    settle(state)
  end

  defp split_closed(%{lossy: true, queue: queue}),
    do: split_list(Situ.Delivery.Queue.to_list(queue))

  defp split_closed(inlet),
    do: split_list(inlet.front ++ (inlet.rear |> :lists.reverse() |> :lists.append()))

  defp split_list(entries) do
    {messages, rest} = Enum.split_while(entries, &is_struct/1)
    {messages, with([{:closed, time} | _] <- rest, do: time, else: (_ -> nil))}
  end

  # Stopping

  defp stop_source(%{stopping: nil} = state, final) do
    state = each_outlet(%{state | final: final, stopping: :asked}, &Outlet.cut(&1, final))
    timers = Enum.filter(state.timers, fn {time, _} -> time <= final end)
    state = %{state | timers: timers}

    state =
      if state.failed,
        do: state,
        else:
          call(state, :handle_stop, [final, %{state.context | now: Clock.now(state.clock)}], nil)

    if state.stopping == :asked, do: stopped(state), else: pump(%{state | idle: false})
  end

  defp stop_source(state, _final), do: state

  @doc false
  def stopped(%{stopping: :done} = state), do: state

  def stopped(state) do
    if holding?(state) and not state.failed do
      %{state | stopping: :held}
    else
      report(state, :source_stopped)
      %{state | stopping: :done}
    end
  end

  # Alarms

  defp alarm(state) do
    now = Clock.now(state.clock)
    state = each_outlet(state, &Outlet.release(&1, now))
    {due, later} = Enum.split_while(state.timers, fn {time, _} -> time <= now end)
    state = Enum.reduce(due, %{state | timers: later, idle: false}, &fire(&1, &2, now))
    state |> settle() |> released() |> pump() |> arm()
  end

  defp fire({_time, key}, %{failed: false} = state, now),
    do: call(state, :handle_info, [{:timer, key}, %{state.context | now: now}], now)

  defp fire(_timer, state, _now), do: state

  defp released(state) do
    if holding?(state) do
      state
    else
      state = if state.completing, do: Actions.complete(state, state.completing), else: state
      if state.stopping == :held, do: stopped(state), else: state
    end
  end

  defp arm(%{timers: [], enforce: false, alarm: nil} = state), do: state

  defp arm(state) do
    case next_due(state) do
      nil -> disarm(state)
      due -> rearm(state, due, Clock.wait_ms(state.clock, due))
    end
  end

  defp rearm(%{alarm: {due, wait, _}} = state, due, wait) when wait != :never, do: state

  defp rearm(state, due, wait) do
    state = disarm(state)

    if wait == :never,
      do: state,
      else: %{state | alarm: {due, wait, Process.send_after(self(), {:situ_alarm, due}, wait)}}
  end

  defp disarm(%{alarm: nil} = state), do: state

  defp disarm(%{alarm: {_, _, ref}} = state) do
    Process.cancel_timer(ref)
    %{state | alarm: nil}
  end

  defp next_due(state) do
    held = for {_, outlet} <- state.outlets, time = Outlet.next_time(outlet), do: time
    timers = for {time, _} <- Enum.take(state.timers, 1), do: time
    Enum.min(held ++ timers, fn -> nil end)
  end

  # Edges

  defp asked(state, tag, n) do
    each_outlet(%{state | idle: false}, fn outlet ->
      if Enum.any?(outlet.subs, &(&1.tag == tag)), do: Outlet.ask(outlet, tag, n), else: outlet
    end)
  end

  defp subscribe(state, {pid, tag}, opts) do
    case Situ.Stage.Setup.find_outlet(state, opts) do
      {:ok, outlet} ->
        sub = Map.put(Outlet.sub(tag, pid, opts[:situ_counters]), :monitor, Process.monitor(pid))
        put_outlet(state, Outlet.subscribe(outlet, sub))

      {:error, error} ->
        send(pid, {:"$gen_consumer", {self(), tag}, {:cancel, error}})
        state
    end
  end

  defp unsubscribe(state, which?) do
    each_outlet(%{state | idle: false}, fn outlet ->
      for %{monitor: ref} = sub <- outlet.subs, which?.(sub), do: Process.demonitor(ref, [:flush])
      Outlet.cancel(outlet, which?)
    end)
  end

  defp closing(inlet, {:shutdown, {:closed, time}}, _state), do: Inlet.push_closed(inlet, time)
  defp closing(inlet, _reason, state), do: Inlet.push_closed(inlet, Clock.now(state.clock))

  # "Drain the mailbox, apply the policy, take one."
  defp drain_mailbox(state) do
    receive do
      {:"$gen_consumer", {_pid, tag}, batch}
      when is_list(batch) and is_map_key(state.inlets, tag) ->
        inlet = Map.fetch!(state.inlets, tag)
        drain_mailbox(put_inlet(state, tag, Inlet.push(inlet, batch)))
    after
      0 -> state
    end
  end

  @doc false
  # A held input is not taken from for 20 ms, or until it is resumed; so its producer runs out of demand and waits. Held
  # again, the time starts anew.
  def hold(state, input, held?) do
    case Enum.find(state.inlets, fn {_, inlet} -> inlet.name == input end) do
      nil ->
        state

      {tag, inlet} ->
        with {timer, _token} <- inlet.held, do: Process.cancel_timer(timer)
        put_inlet(state, tag, %{inlet | held: if(held?, do: hold_timer(tag))})
    end
  end

  defp hold_timer(tag) do
    token = make_ref()
    {Process.send_after(self(), {:situ_hold, tag, token}, @hold_ms), token}
  end

  defp earliest(inlets) when map_size(inlets) == 0, do: nil

  defp earliest(inlets) do
    inlets
    |> Enum.reduce(nil, fn {tag, inlet}, best ->
      case {Inlet.head_time(inlet), best} do
        {:none, best} -> best
        {time, {best_time, _, _}} when time >= best_time -> best
        {time, _} -> {time, tag, inlet}
      end
    end)
    |> case do
      nil -> nil
      {_, tag, inlet} -> {tag, inlet}
    end
  end

  @doc false
  def settle(state) do
    state = state |> run_tail() |> flush()
    inlets = Enum.reduce(state.inlets, state.inlets, &settle_inlet/2)
    %{state | inlets: inlets}
  end

  defp flush(%{tail: tail, phase: :starting} = state) when tail != nil, do: state
  defp flush(state), do: each_outlet(state, &Outlet.flush/1)

  defp run_tail(%{tail: nil} = state), do: state

  # Before the start there is no clock: what a source posts from handle_start waits for its first turn.
  defp run_tail(%{phase: :starting} = state), do: state

  defp run_tail(state) do
    if Enum.any?(state.outlets, fn {key, outlet} -> is_atom(key) and outlet.pending != [] end),
      do: Situ.Stage.Run.tail(state, Clock.now(state.clock), :atomics.get(state.control, 1)),
      else: state
  end

  defp settle_inlet({tag, inlet}, inlets) do
    case Inlet.settle(inlet) do
      {0, ^inlet} ->
        inlets

      {0, inlet} ->
        Map.put(inlets, tag, inlet)

      {n, inlet} ->
        send_ask(inlet, n)
        Map.put(inlets, tag, inlet)
    end
  end

  defp send_ask(inlet, n),
    do: send(inlet.producer, {:"$gen_producer", {self(), inlet.tag}, {:ask, n}})

  defp first_demand(%{window: window}), do: window
  defp owed(%{lossy: true}), do: 0
  defp owed(_inlet), do: 1

  defp room(%{outlets: outlets}) do
    Enum.reduce(outlets, :infinity, fn {_, outlet}, room -> min(room, Outlet.room(outlet)) end)
  end

  defp each_outlet(%{outlets: outlets} = state, fun),
    do: %{state | outlets: Map.new(outlets, fn {name, outlet} -> {name, fun.(outlet)} end)}

  defp put_outlet(%{tail: nil} = state, outlet),
    do: %{state | outlets: Map.put(state.outlets, outlet.name, outlet)}

  defp put_outlet(state, outlet),
    do: %{state | outlets: Map.put(state.outlets, {:tail, outlet.name}, outlet)}

  defp put_inlet(state, tag, inlet), do: %{state | inlets: Map.put(state.inlets, tag, inlet)}

  defp schedule(%{scheduled: true} = state), do: state

  defp schedule(state) do
    send(self(), :situ_pump)
    %{state | scheduled: true}
  end

  defp report(state, event), do: send(state.server, {:situ_stage, state.id, event})

  @doc "The context a component sees before the pipeline has a clock."
  @spec context(map()) :: Context.t()
  def context(args), do: %Context{path: hd(args.vertices).path, pipeline: args.handle}
end
