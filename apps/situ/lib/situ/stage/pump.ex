defmodule Situ.Stage.Pump do
  @moduledoc false
  # Takes messages as long as there are any, there is room for what comes of them, and the slice of time lasts.
  alias Situ.{Clock, Stage}
  alias Situ.Stage.{Actions, Alarm, Call, Fault, Inlet, Outlet, Ports, Run, Source, Turn}

  @slice_ns 5_000_000
  @flush_ns 200_000

  @spec pump(Stage.t()) :: Stage.t()
  def pump(%{phase: :running, failed: false, kind: :chain} = state) do
    now = Clock.now(state.clock)
    final = :atomics.get(state.control, 1)
    chain(state, now, now + @slice_ns, final)
  end

  def pump(%{phase: :running, failed: false} = state) do
    now = Clock.now(state.clock)
    final = :atomics.get(state.control, 1)
    state |> take(now, {now, now + @slice_ns}, final) |> Alarm.arm()
  end

  def pump(%{phase: :running} = state), do: discard(state)
  def pump(state), do: state

  # A component: one message at a time, the earliest among its inputs first.
  defp take(state, now, {_from, till} = times, final) do
    state = if state.lossy, do: Ports.drain_mailbox(state), else: state

    cond do
      now > till -> Ports.schedule(Ports.settle(state))
      Ports.room(state) < 1 -> blocked(state, now, times, final)
      true -> take_next(state, now, times, final)
    end
  end

  defp blocked(state, now, times, final) do
    state = Ports.settle(state)
    if Ports.room(state) < 1, do: state, else: take_next(state, now, times, final)
  end

  defp take_next(state, now, times, final) do
    case Ports.earliest(state.inlets) do
      nil ->
        Source.produce(Ports.settle(state), now, final)

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
    room = min(Ports.room(state), state.slice)

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
      {state |> Ports.put_inlet(tag, rest) |> resize(n, after_time - now), after_time}
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
      do: take(Ports.settle(state), now, {now, till}, final),
      else: take(state, now, {from, till}, final)
  end

  defp entry(nil, state, tag, inlet, now, _final), do: {Ports.put_inlet(state, tag, inlet), now}

  defp entry({:closed, time}, state, tag, inlet, now, _final) do
    {closed(Ports.settle(Ports.put_inlet(state, tag, inlet)), tag, inlet, time), now}
  end

  defp entry(%{originating_time: time}, state, tag, inlet, now, final) when time > final do
    Inlet.drop(inlet, 1)
    {Ports.put_inlet(state, tag, %{inlet | owed: inlet.owed + owed(inlet)}), now}
  end

  defp entry(message, state, tag, inlet, now, _final) do
    state = handle(state, tag, inlet, message, now)
    after_time = Clock.now(state.clock)
    inlet = Map.get(state.inlets, tag, inlet)
    inlet = Inlet.handled(inlet, 1, message.originating_time, {now, after_time - now})
    {Ports.put_inlet(state, tag, inlet), after_time}
  end

  defp handle(state, tag, inlet, message, now) do
    path = state.head.path

    with {:ok, inlet} <- Inlet.check(inlet, message, path),
         context = %{state.context | now: now},
         {:ok, actions, core} <-
           Call.message(state.module, inlet.name, message, context, state.core, path),
         state = Ports.put_inlet(state, tag, inlet),
         {:ok, state} <- Actions.run(%{state | core: core}, actions, now) do
      state
    else
      {:error, error} ->
        Fault.wrong(Ports.put_inlet(state, tag, inlet), Call.at(error, inlet.name, message))
    end
  end

  defp closed(state, tag, inlet, time) do
    state = %{state | inlets: Map.delete(state.inlets, tag)}

    state =
      if state.kind == :component and not state.failed,
        do: Turn.call(state, :handle_closed, [inlet.name, time, state.context], nil),
        else: state

    state = Ports.settle(state)
    Stage.report(state, {:unsubscribed, tag, inlet.name, time})
    state
  end

  # A chain: as many messages at once as there is room for; slices grow while they are quick.
  defp chain(%{inlets: inlets} = state, _now, _till, _final) when map_size(inlets) == 0,
    do: Ports.settle(state)

  defp chain(state, now, till, final) do
    state = if state.lossy, do: Ports.drain_mailbox(state), else: state
    [{tag, inlet}] = Map.to_list(state.inlets)
    [{_, outlet}] = Map.to_list(state.outlets)

    case chain_take(inlet, Outlet.room(outlet), state.slice, now) do
      {[], inlet} ->
        Ports.settle(Ports.put_inlet(state, tag, inlet))

      {:closed, time, inlet} ->
        closed_chain(state, tag, inlet, time)

      {messages, inlet} ->
        chain_run(Ports.put_inlet(state, tag, inlet), tag, messages, {now, till, final})
    end
  end

  defp closed_chain(state, tag, inlet, time), do: closed(Ports.settle(state), tag, inlet, time)

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
    {state, last, n} = Run.batch(state, messages, now, final)
    after_time = Clock.now(state.clock)
    inlet = Map.fetch!(state.inlets, tag)
    inlet = if n > 0, do: Inlet.handled(inlet, n, last, {now, after_time - now}), else: inlet
    state = state |> Ports.put_inlet(tag, inlet) |> resize(n, after_time - now)

    cond do
      state.failed -> discard(Ports.settle(state))
      after_time > till -> Ports.schedule(Ports.settle(state))
      n >= 64 and after_time - now < @flush_ns -> chain(state, after_time, till, final)
      true -> chain(Ports.settle(state), after_time, till, final)
    end
  end

  @doc "Slices grow while they are quick, and shrink when they are slow."
  @spec resize(Stage.t(), non_neg_integer(), integer()) :: Stage.t()
  def resize(%{slice: slice} = state, n, elapsed) do
    cond do
      elapsed > 1_000_000 and slice > 1 -> %{state | slice: div(slice, 2)}
      elapsed < 100_000 and n == slice and slice < 512 -> %{state | slice: slice * 2}
      true -> state
    end
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
        state = Ports.put_inlet(state, tag, inlet)
        if closed, do: closed(state, tag, inlet, closed), else: state
      end)

    Ports.settle(state)
  end

  defp split_closed(%{lossy: true, queue: queue}),
    do: split_list(Situ.Delivery.Queue.to_list(queue))

  defp split_closed(inlet),
    do: split_list(inlet.front ++ (inlet.rear |> :lists.reverse() |> :lists.append()))

  defp split_list(entries) do
    {messages, rest} = Enum.split_while(entries, &is_struct/1)
    {messages, with([{:closed, time} | _] <- rest, do: time, else: (_ -> nil))}
  end

  defp owed(%{lossy: true}), do: 0
  defp owed(_inlet), do: 1
end
