defmodule Situ.Stage.Ports do
  @moduledoc false
  # The inputs and outputs of a stage as a whole: demand and room, subscribers, who is next.
  alias Situ.{Clock, Stage}
  alias Situ.Stage.{Inlet, Outlet, Run, Setup, Subscriber}

  @hold_ms 20
  @many 64
  @wide 32_768

  @spec drained?(Stage.t()) :: boolean()
  def drained?(state), do: Enum.all?(state.outlets, fn {_, outlet} -> outlet.subs == [] end)

  @doc "Whether messages wait for their time."
  @spec holding?(Stage.t()) :: boolean()
  def holding?(state), do: Enum.any?(state.outlets, fn {_, o} -> o.future != [] end)

  @doc "A consumer asked for more."
  @spec asked(Stage.t(), term(), pos_integer() | :infinity) :: Stage.t()
  def asked(state, tag, n) do
    each_outlet(%{state | idle: false}, fn outlet ->
      if Enum.any?(outlet.subs, &(&1.tag == tag)), do: Outlet.ask(outlet, tag, n), else: outlet
    end)
  end

  @doc "A process from outside subscribes."
  @spec subscribe(Stage.t(), {pid(), term()}, keyword()) :: Stage.t()
  def subscribe(state, {pid, tag}, opts) do
    case Setup.find_outlet(state, opts) do
      {:ok, outlet} ->
        sub = %{Subscriber.new(tag, pid, opts[:situ_counters]) | monitor: Process.monitor(pid)}
        put_outlet(state, Outlet.subscribe(outlet, sub))

      {:error, error} ->
        send(pid, {:"$gen_consumer", {self(), tag}, {:cancel, error}})
        state
    end
  end

  @spec unsubscribe(Stage.t(), (Subscriber.t() -> boolean())) :: Stage.t()
  def unsubscribe(state, which?) do
    each_outlet(%{state | idle: false}, fn outlet ->
      for %{monitor: ref} = sub when ref != nil <- outlet.subs,
          which?.(sub),
          do: Process.demonitor(ref, [:flush])

      Outlet.cancel(outlet, which?)
    end)
  end

  @spec closing(Inlet.t(), term(), Stage.t()) :: Inlet.t()
  def closing(inlet, {:shutdown, {:closed, time}}, _state), do: Inlet.push_closed(inlet, time)
  def closing(inlet, _reason, state), do: Inlet.push_closed(inlet, Clock.now(state.clock))

  # "Drain the mailbox, apply the policy, take one."
  @spec drain_mailbox(Stage.t()) :: Stage.t()
  def drain_mailbox(state) do
    receive do
      {:"$gen_consumer", {_pid, tag}, batch}
      when is_list(batch) and is_map_key(state.inlets, tag) ->
        inlet = Map.fetch!(state.inlets, tag)
        drain_mailbox(put_inlet(state, tag, Inlet.push(inlet, batch)))
    after
      0 -> state
    end
  end

  # A held input is not taken from for 20 ms, or until it is resumed; so its producer runs out of demand and waits. Held
  # again, the time starts anew.
  @spec hold(Stage.t(), atom(), boolean()) :: Stage.t()
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

  @doc "The input whose head is the oldest."
  @spec earliest(%{term() => Inlet.t()}) :: {term(), Inlet.t()} | nil
  def earliest(inlets) when map_size(inlets) == 0, do: nil

  def earliest(inlets) do
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

  @doc "One subscriber gets all that waits for it, asked for or not, and the closing mark."
  @spec cut(Stage.t(), term(), Situ.Time.t()) :: Stage.t()
  def cut(state, tag, time) do
    for {_, outlet} <- state.outlets,
        %{tag: ^tag} = sub <- outlet.subs,
        do: sub |> Subscriber.ask(:infinity) |> Subscriber.send_close(time)

    unsubscribe(state, &(&1.tag == tag))
  end

  @doc "Closes the outputs at `time`; where later messages count, not before the last one."
  @spec close(Stage.t(), Situ.Time.t()) :: Stage.t()
  def close(state, time) do
    whole? = state.control != nil and :atomics.get(state.control, 1) == Stage.never()

    each_outlet(
      state,
      &Outlet.close(&1, if(whole?, do: max(&1.last_time || time, time), else: time))
    )
  end

  @doc "Sends what is pending, publishes counts and asks for more."
  @spec settle(Stage.t()) :: Stage.t()
  def settle(state) do
    state = state |> run_tail() |> widen() |> flush()
    inlets = Enum.reduce(state.inlets, state.inlets, &settle_inlet/2)
    %{state | inlets: inlets}
  end

  # A stage that handles many messages at once is given a heap that holds them, once: they would otherwise be copied by one
  # collection after another.
  defp widen(%{wide: true} = state), do: state

  defp widen(state) do
    if Enum.any?(state.inlets, fn {_, inlet} -> inlet.taken >= @many end) or
         Enum.any?(state.outlets, fn {_, outlet} -> outlet.pending_n >= @many end) do
      Process.flag(:min_heap_size, @wide)
      %{state | wide: true}
    else
      state
    end
  end

  defp flush(%{tail: tail, phase: :starting} = state) when tail != nil, do: state
  defp flush(state), do: each_outlet(state, &Outlet.flush/1)

  defp run_tail(%{tail: nil} = state), do: state

  # Before the start there is no clock: what a source posts from handle_start waits for its first turn.
  defp run_tail(%{phase: :starting} = state), do: state

  defp run_tail(state) do
    if Enum.any?(state.outlets, fn {key, outlet} -> is_atom(key) and outlet.pending != [] end),
      do: Run.tail(state, Clock.now(state.clock), :atomics.get(state.control, 1)),
      else: state
  end

  defp settle_inlet({tag, inlet}, inlets) do
    case Inlet.settle(inlet) do
      {0, ^inlet} ->
        inlets

      {0, inlet} ->
        Map.put(inlets, tag, inlet)

      {n, inlet} ->
        ask(inlet, n)
        Map.put(inlets, tag, inlet)
    end
  end

  @spec ask(Inlet.t(), pos_integer() | :infinity) :: term()
  def ask(inlet, n),
    do: send(inlet.producer, {:"$gen_producer", {self(), inlet.tag}, {:ask, n}})

  @doc "How many messages may go out now."
  @spec room(Stage.t()) :: integer() | :infinity
  def room(%{outlets: outlets}) do
    Enum.reduce(outlets, :infinity, fn {_, outlet}, room -> min(room, Outlet.room(outlet)) end)
  end

  @spec each_outlet(Stage.t(), (Outlet.t() -> Outlet.t())) :: Stage.t()
  def each_outlet(%{outlets: outlets} = state, fun),
    do: %{state | outlets: Map.new(outlets, fn {name, outlet} -> {name, fun.(outlet)} end)}

  @spec put_outlet(Stage.t(), Outlet.t()) :: Stage.t()
  def put_outlet(%{tail: nil} = state, outlet),
    do: %{state | outlets: Map.put(state.outlets, outlet.name, outlet)}

  def put_outlet(state, outlet),
    do: %{state | outlets: Map.put(state.outlets, {:tail, outlet.name}, outlet)}

  @spec put_inlet(Stage.t(), term(), Inlet.t()) :: Stage.t()
  def put_inlet(state, tag, inlet), do: %{state | inlets: Map.put(state.inlets, tag, inlet)}

  @doc "Another turn, after what is in the mailbox."
  @spec schedule(Stage.t()) :: Stage.t()
  def schedule(%{scheduled: true} = state), do: state

  def schedule(state) do
    send(self(), :situ_pump)
    %{state | scheduled: true}
  end
end
