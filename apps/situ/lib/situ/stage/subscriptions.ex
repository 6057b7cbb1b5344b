defmodule Situ.Stage.Subscriptions do
  @moduledoc false
  # Adds and removes connections of a running stage: subscribers of its outputs, taps on streams inside a chain, and
  # inputs of a component that accepts more.
  alias Situ.{Clock, Error}
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  alias Situ.Ports.{Counters, Input, Inputs, Output, Outputs, Subscriber}
  alias Situ.Stage.{CallbackRunner, ActionRunner, State}

  @most_waiting 1_000

  @doc "Handles a GenStage message of a consumer that subscribes, asks or cancels; others end the subscription."
  @spec handle_consumer_request(State.t(), {pid(), term()}, term()) :: State.t()
  def handle_consumer_request(state, from, {:ask, n})
      when (is_integer(n) and n > 0) or n == :infinity do
    case Outputs.add_demand(state.outputs, from, n) do
      {:ok, outputs} -> State.wake_source(%{state | outputs: outputs})
      :error -> unknown(state, from)
    end
  end

  def handle_consumer_request(state, _from, {:ask, 0}), do: state

  def handle_consumer_request(state, from, {:subscribe, _current, opts}) do
    if consumer?(state, from),
      do: refuse(state, from, :duplicated_subscription),
      else: subscribe(state, from, opts)
  end

  # Any process may call `GenStage.cancel/2`: the reference identifies the subscription.
  def handle_consumer_request(state, {pid, tag} = from, {:cancel, reason}) do
    case Enum.find(Outputs.list_subscribers(state.outputs), &matches?(&1, from)) do
      nil ->
        refuse(state, {pid, tag}, reason)

      sub ->
        Subscriber.send_cancel(sub, reason)
        leave(state, &(&1.tag == sub.tag and &1.pid == sub.pid))
    end
  end

  def handle_consumer_request(state, from, request) do
    what = "#{inspect(request, limit: 8, printable_limit: 80)} is not a request of a consumer"
    fix = "{:subscribe, current, opts}, {:ask, count} and {:cancel, reason} are"
    error = Error.new(:bad_request, what, fix: fix)

    if consumer?(state, from),
      do: state |> refuse(from, error) |> leave(&matches?(&1, from)),
      else: unknown(state, from)
  end

  defp consumer?(state, from),
    do: Enum.any?(Outputs.list_all(state.outputs), &Output.has_subscriber?(&1, from))

  defp matches?(sub, {_pid, tag}) when is_reference(tag), do: sub.tag == tag
  defp matches?(sub, {pid, tag}), do: sub.tag == tag and sub.pid == pid

  # Within the pipeline (tags are numbers) it is a last word that has crossed the end of the connection.
  defp unknown(state, {_pid, tag}) when is_integer(tag), do: state
  defp unknown(state, from), do: refuse(state, from, :unknown_subscription)

  defp refuse(state, {pid, tag}, reason) do
    send(pid, {:"$gen_consumer", {self(), tag}, {:cancel, reason}})
    state
  end

  @doc "Removes the consumer with this monitor, whose process has ended."
  @spec remove_by_monitor(State.t(), reference()) :: State.t()
  def remove_by_monitor(state, monitor), do: leave(state, &(&1.monitor == monitor))

  defp leave(state, which?),
    do: State.wake_source(%{state | outputs: Outputs.remove_subscribers(state.outputs, which?)})

  defp subscribe(state, {pid, tag} = from, opts) do
    with :ok <- options(opts), {:ok, output} <- State.find_output(state, opts) do
      sub = %{Subscriber.new(tag, pid, nil) | monitor: Process.monitor(pid)}
      put(state, output.port.name, &Output.subscribe(&1, sub))
    else
      {:error, error} -> refuse(state, from, error)
    end
  end

  defp options(opts) do
    if Keyword.keyword?(opts) do
      :ok
    else
      {:error,
       Error.new(
         :bad_subscription,
         "subscription options are a keyword list, not #{inspect(opts)}",
         fix: "see Situ.GenStage.subscription/2"
       )}
    end
  end

  defp put(state, name, fun),
    do: %{state | outputs: Outputs.update_open(state.outputs, name, fun)}

  @doc "Adds a tap on an output, or after the operator at `index` of a chain."
  @spec add_tap(State.t(), map()) :: State.t()
  def add_tap(state, %{index: nil} = tap) do
    {:ok, output} = State.find_output(state, output: tap.output)
    sub = Subscriber.new(tap.tag, tap.pid, tap.counters, tap.policy)
    put(state, output.port.name, &Output.subscribe(&1, sub))
  end

  def add_tap(state, tap) do
    state = probe(state, tap)
    ended = for %{closing: time} when time != nil <- Outputs.list_all(state.outputs), do: time
    if ended != [], do: close_probe(tap.tag, tap.pid, hd(ended))
    state
  end

  # A step that sends copies of messages. It has no demand, so a slow tap misses messages.
  defp probe(state, %{tag: tag, pid: pid, counters: counters} = tap) do
    me = self()
    [{_name, port} | _] = Enum.at(state.vertices, tap.index).outputs

    look = fn data, message ->
      age = message.creation_time - message.originating_time
      Counters.count_emitted(counters, 1, age, age)
      Counters.record_sent(counters, message.originating_time, message.creation_time)
      {emitted, processed, dropped} = Counters.flow_counts(counters)

      if emitted - processed - dropped > @most_waiting,
        do: Counters.count_dropped(counters, 1),
        else:
          send(
            pid,
            {:"$gen_consumer", {me, tag}, [%{message | data: data, source_id: port.source_id}]}
          )
    end

    step = {:each2, look, {:probe, tag, pid}}
    %{state | chain: Chain.update_steps(state.chain, &insert(&1, tap.index, step))}
  end

  # In front of the first step of a later operator.
  defp insert(steps, index, step) do
    {before, rest} = Enum.split_while(steps, &(is_tuple(elem(&1, 2)) or elem(&1, 2) <= index))
    before ++ [step | rest]
  end

  @doc "Notifies the taps inside the chain that their stream has ended."
  @spec close_probes(State.t(), Situ.Time.t()) :: :ok
  def close_probes(%{chain: nil}, _time), do: :ok

  def close_probes(%{chain: chain}, time) do
    for {_kind, _look, {:probe, tag, pid}} <- chain.steps, do: close_probe(tag, pid, time)
    :ok
  end

  defp close_probe(tag, pid, time),
    do: send(pid, {:"$gen_consumer", {self(), tag}, {:cancel, {:shutdown, {:closed, time}}}})

  @doc "Removes a tap or another subscriber."
  @spec remove_subscriber(State.t(), term()) :: State.t()
  def remove_subscriber(state, tag) do
    state = %{state | outputs: Outputs.remove_subscribers(state.outputs, &(&1.tag == tag))}

    if state.chain,
      do: %{
        state
        | chain: Chain.update_steps(state.chain, &Enum.reject(&1, fn s -> probe?(s, tag) end))
      },
      else: state
  end

  defp probe?({_kind, _look, {:probe, tag, _pid}}, tag), do: true
  defp probe?(_step, _tag), do: false

  @doc """
  Adds a subscriber without demand, so that it loses no messages before its first request. Returns the last time that it
  will not see, or the time at which the output ended.
  """
  @spec lend_output(State.t(), term(), atom(), pid(), term(), Situ.Delivery.t() | nil) ::
          {{:open, Situ.Time.t() | nil} | {:closed, Situ.Time.t()}, State.t()}
  def lend_output(state, tag, name, pid, counters, policy) do
    case State.find_output(state, output: name) do
      {:ok, %{closed: true, closing: time}} ->
        {{:closed, time}, state}

      {:ok, output} ->
        sub = Subscriber.new(tag, pid, counters, policy)
        {{:open, output.last_time}, put(state, name, &Output.subscribe(&1, sub))}
    end
  end

  @doc "Adds an input if the component accepts it, and requests its first messages."
  @spec attach_input(State.t(), term(), Situ.Time.t() | nil, map()) ::
          {:ok, term(), State.t()} | {:error, Error.t()}
  def attach_input(%{phase: :failed}, _request, _last, _wiring), do: {:error, failed()}

  def attach_input(state, request, last, wiring) do
    now = Clock.now(state.clock)
    args = [wiring.name, request, last, State.context_at(state, now)]

    with {:ok, reply, opts, actions, core} <-
           Callback.call_with_reply(state.callback, :handle_attach, args) do
      port = {wiring.name, %{type: :any, optional: true}}
      head = State.head_vertex(state)
      state = State.put_head(state, %{head | inputs: head.inputs ++ [port]})
      state = state |> ActionRunner.put_options(opts) |> connect(wiring)
      {:ok, reply, CallbackRunner.apply_result(state, core, actions, now)}
    end
  end

  defp connect(state, wiring) do
    extra = %{type: :any, check: :off, counters: wiring.counters, sizes: wiring.sizes}
    input = Input.new(wiring.name, wiring.tag, wiring.producer, wiring.policy, extra)

    input =
      case wiring.end do
        {:closed, time} ->
          Input.push_closed(input, time)

        {:open, _last} ->
          Input.request_first(input)
          input
      end

    %{state | inputs: Inputs.put(state.inputs, input)}
  end

  @doc "Asks the component to release an input that was added while it was running."
  @spec detach_input(State.t(), term()) :: {:ok, term(), State.t()} | {:error, Error.t()}
  def detach_input(%{phase: :failed}, _request), do: {:error, failed()}

  def detach_input(state, request) do
    now = Clock.now(state.clock)
    args = [request, State.context_at(state, now)]

    with {:ok, reply, opts, actions, core} <-
           Callback.call_with_reply(state.callback, :handle_detach, args),
         do:
           {:ok, reply,
            state
            |> ActionRunner.put_options(opts)
            |> CallbackRunner.apply_result(core, actions, now)}
  end

  @doc "Removes the connection of an input that the component has detached."
  @spec remove_input(State.t(), atom()) :: State.t()
  def remove_input(state, name) do
    head = State.head_vertex(state)
    state = State.put_head(state, %{head | inputs: Keyword.delete(head.inputs, name)})
    State.report_event(state, {:detached, name, state.callback.opts})

    case Inputs.find_by_name(state.inputs, name) do
      nil ->
        state

      input ->
        send(input.producer, {:"$gen_producer", {self(), input.tag}, {:cancel, :normal}})
        Input.set_hold(input, false)
        %{state | inputs: Inputs.delete(state.inputs, input.tag)}
    end
  end

  defp failed do
    Error.new(:not_running, "the component has failed", why: "it takes no messages any more")
  end
end
