defmodule Situ.Stage.Subscriptions do
  @moduledoc false
  # Adds and removes connections of a running stage: subscribers of its outputs, taps on streams inside a chain, and
  # inputs of a component that accepts more.
  alias Situ.Error
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  alias Situ.Ports.{Address, Counters, Input, Inputs, Output, Outputs, Subscriber}
  alias Situ.Stage.{CallbackRunner, State, Step}

  @most_waiting 1_000

  @doc "Initializes the component's state."
  @spec start_component(State.t()) :: {:ok, State.t()} | {:error, Error.t()}
  def start_component(%{steps: steps} = state) do
    with %{worker: %Callback{} = worker} = step <- elem(steps, 0),
         {:ok, worker} <- Callback.start_component(worker) do
      {:ok, State.put_step(state, 0, %{step | worker: worker})}
    else
      {:error, error} -> {:error, error}
      _chain -> {:ok, state}
    end
  end

  @doc "Handles a GenStage message of a consumer that subscribes, asks or cancels; others end the subscription."
  @spec handle_consumer_request(State.t(), {pid(), term()}, term()) :: State.t()
  def handle_consumer_request(state, from, {:ask, n})
      when (is_integer(n) and n > 0) or n == :infinity do
    case State.update_outputs(state, &Outputs.add_demand(&1, from, n)) do
      {:ok, state} -> wake_sources(state)
      :error -> refuse_unknown(state, from)
    end
  end

  def handle_consumer_request(state, _from, {:ask, 0}), do: state

  def handle_consumer_request(state, {pid, tag} = from, {:subscribe, _current, opts}) do
    if Enum.any?(State.list_subscribers(state), &match?(%{tag: ^tag, pid: ^pid}, &1)),
      do: refuse(state, from, :duplicated_subscription),
      else: subscribe(state, from, opts)
  end

  # Any process may call `GenStage.cancel/2`: the reference identifies the subscription.
  def handle_consumer_request(state, from, {:cancel, reason}) do
    case Enum.find(State.list_subscribers(state), &matches?(&1, from)) do
      nil ->
        refuse(state, from, reason)

      sub ->
        Subscriber.send_cancel(sub, reason)
        remove_subscribers(state, &(&1.tag == sub.tag and &1.pid == sub.pid))
    end
  end

  def handle_consumer_request(state, from, request) do
    what = "#{inspect(request, limit: 8, printable_limit: 80)} is not a request of a consumer"
    fix = "{:subscribe, current, opts}, {:ask, count} and {:cancel, reason} are"
    error = Error.new(:bad_request, what, fix: fix)

    if Enum.any?(State.list_subscribers(state), &matches?(&1, from)),
      do: state |> refuse(from, error) |> remove_subscribers(&matches?(&1, from)),
      else: refuse_unknown(state, from)
  end

  defp matches?(sub, {_pid, tag}) when is_reference(tag), do: sub.tag == tag
  defp matches?(sub, {pid, tag}), do: sub.tag == tag and sub.pid == pid

  # Within the pipeline (tags are numbers) it is a last message that has crossed the end of the connection.
  defp refuse_unknown(state, {_pid, tag}) when is_integer(tag), do: state
  defp refuse_unknown(state, from), do: refuse(state, from, :unknown_subscription)

  defp refuse(state, {pid, tag}, reason) do
    send(pid, {:"$gen_consumer", {self(), tag}, {:cancel, reason}})
    state
  end

  @doc "Removes the consumer with this monitor, whose process has ended."
  @spec remove_by_monitor(State.t(), reference()) :: State.t()
  def remove_by_monitor(state, monitor), do: remove_subscribers(state, &(&1.monitor == monitor))

  defp remove_subscribers(state, which?),
    do: state |> State.map_outputs(&Outputs.remove_subscribers(&1, which?)) |> wake_sources()

  @doc "Wakes the sources of the stage, which may have messages again."
  @spec wake_sources(State.t()) :: State.t()
  def wake_sources(%{steps: steps} = state) do
    if elem(steps, 0).source.idle,
      do: State.update_step(state, 0, &Step.wake_source/1),
      else: state
  end

  defp subscribe(state, from, opts) do
    {i, step} = State.last_step(state)

    with :ok <- check_options(opts),
         {:ok, output} <- State.find_output(state, opts),
         {:ok, outputs} <- subscribe_consumer(step.outputs, output.port.name, from, opts) do
      State.put_step(state, i, %{step | outputs: outputs})
    else
      {:error, error} -> refuse(state, from, error)
    end
  end

  defp subscribe_consumer(outputs, name, {pid, tag}, opts) do
    sub = %{Subscriber.new(tag, pid, nil) | monitor: Process.monitor(pid)}

    with {:error, error} <- Outputs.subscribe(outputs, name, sub, opts) do
      Process.demonitor(sub.monitor, [:flush])
      {:error, error}
    end
  end

  defp check_options(opts) do
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

  defp add_subscriber(state, output, sub) do
    {i, _step} = State.last_step(state)
    State.update_step(state, i, &put_output(&1, Output.subscribe(output, sub)))
  end

  defp put_output(step, output), do: %{step | outputs: Outputs.put(step.outputs, output)}

  @doc "Adds a tap on an output, or after the vertex at `index` of the stage."
  @spec add_tap(State.t(), map()) :: State.t()
  def add_tap(state, %{index: nil} = tap) do
    {:ok, output} = State.find_output(state, output: tap.output)
    add_subscriber(state, output, Subscriber.new(tap.tag, tap.pid, tap.counters, tap.policy))
  end

  def add_tap(state, tap) do
    {i, step} = State.step_at(state, tap.index)

    if tap.index == step.index + length(step.vertices) - 1,
      do: State.put_step(state, i, tap_step(step, tap)),
      else: State.put_step(state, i, probe_chain(step, tap))
  end

  # The output of a step is a stream like any other, although another step of the stage takes it.
  defp tap_step(step, tap) do
    sub = Subscriber.new(tap.tag, tap.pid, tap.counters, tap.policy)
    {:ok, output} = Outputs.fetch(step.outputs, tap.output)
    put_output(step, Output.subscribe(output, sub))
  end

  # A step that sends copies of messages. It has no demand, so a slow tap misses messages.
  defp probe_chain(step, %{tag: tag, pid: pid, counters: counters} = tap) do
    me = self()
    [{_name, port} | _] = Enum.at(step.vertices, tap.index - step.index).outputs

    send_copy = fn data, message ->
      age = message.creation_time - message.originating_time
      Counters.count_emitted(counters, 1, age, age)
      Counters.record_sent(counters, message.originating_time, message.creation_time)
      {emitted, processed, dropped} = Counters.flow_counts(counters)

      if emitted - processed - dropped > @most_waiting do
        Counters.count_dropped(counters, 1)
      else
        copy = %{message | data: data, source_id: port.source_id}
        send(pid, {:"$gen_consumer", {me, tag}, [[copy]]})
      end
    end

    probe = {:each2, send_copy, {:probe, tag, pid}}

    for {_, output} <- step.outputs.own,
        time = Output.closing_time(output),
        do: close_probe(tag, pid, time)

    %{step | worker: Chain.update_steps(step.worker, &insert_probe(&1, tap.index, probe))}
  end

  # In front of the first step of a later operator.
  defp insert_probe(steps, index, probe) do
    {before, rest} = Enum.split_while(steps, &(is_tuple(elem(&1, 2)) or elem(&1, 2) <= index))
    before ++ [probe | rest]
  end

  @doc "Notifies the taps inside the chain that their stream has ended."
  @spec close_probes(Step.t(), Situ.Time.t()) :: :ok
  def close_probes(%{worker: %Chain{steps: steps}}, time) do
    for {_kind, _send_copy, {:probe, tag, pid}} <- steps, do: close_probe(tag, pid, time)
    :ok
  end

  def close_probes(_step, _time), do: :ok

  defp close_probe(tag, pid, time),
    do: send(pid, {:"$gen_consumer", {self(), tag}, {:cancel, {:shutdown, {:closed, time}}}})

  @doc "Removes a tap or another subscriber."
  @spec remove_subscriber(State.t(), term()) :: State.t()
  def remove_subscriber(state, tag) do
    State.map_steps(state, fn step ->
      step = %{step | outputs: Outputs.remove_subscribers(step.outputs, &(&1.tag == tag))}
      remove_probe(step, tag)
    end)
  end

  defp remove_probe(%{worker: %Chain{steps: steps} = chain} = step, tag) do
    if Enum.any?(steps, &probe?(&1, tag)),
      do: %{
        step
        | worker: Chain.update_steps(chain, &Enum.reject(&1, fn s -> probe?(s, tag) end))
      },
      else: step
  end

  defp remove_probe(step, _tag), do: step

  defp probe?({_kind, _send_copy, {:probe, tag, _pid}}, tag), do: true
  defp probe?(_step, _tag), do: false

  @doc """
  Adds a subscriber without demand, so that it loses no messages before its first request. Returns the last time that it
  will not see, or the time at which the output ended.
  """
  @spec lend_output(State.t(), atom(), Subscriber.t()) ::
          {{:open, Situ.Time.t() | nil} | {:closed, Situ.Time.t()}, State.t()}
  def lend_output(state, name, sub) do
    case State.find_output(state, output: name) do
      {:ok, %{ending: {:closed, time}}} -> {{:closed, time}, state}
      {:ok, output} -> {{:open, output.last_time}, add_once(state, output, sub)}
    end
  end

  # A stage that was restarted in the meantime has been wired with the new consumer already, or with an earlier one.
  defp add_once(state, output, %{tag: tag, pid: pid} = sub) do
    if Enum.any?(output.subs, &match?(%{tag: ^tag, pid: ^pid}, &1)) do
      state
    else
      subs = Enum.reject(output.subs, &(&1.tag == tag))
      add_subscriber(state, %{output | subs: subs}, sub)
    end
  end

  @doc "Adds an input if the component accepts it, and requests its first messages."
  @spec attach_input(State.t(), term(), Situ.Time.t() | nil, map()) ::
          {:ok, term(), State.t()} | {:error, Error.t()}
  def attach_input(%{steps: steps} = state, request, last, wiring) do
    connect = &connect_input(&1, wiring)
    change_inputs(state, elem(steps, 0), {:handle_attach, [wiring.name, request, last]}, connect)
  end

  @doc "Asks the component to release an input that was added while it was running."
  @spec detach_input(State.t(), term()) :: {:ok, term(), State.t()} | {:error, Error.t()}
  def detach_input(%{steps: steps} = state, request),
    do: change_inputs(state, elem(steps, 0), {:handle_detach, [request]}, & &1)

  defp change_inputs(_state, %{phase: :failed}, _call, _change) do
    {:error,
     Error.new(:not_running, "the component has failed", why: "it takes no messages any more")}
  end

  defp change_inputs(state, step, {callback, args}, change) do
    step = Step.read_clock(step)

    with {:ok, reply, opts, actions, core} <-
           Callback.call_with_reply(step.worker, callback, args ++ [step.context]) do
      step = step |> Step.put_options(opts) |> change.()
      {:ok, reply, State.put_step(state, 0, CallbackRunner.apply_result(step, core, actions))}
    end
  end

  defp connect_input(step, wiring) do
    port = {wiring.name, %{type: :any, optional: true}}
    step = Step.update_head(step, &%{&1 | inputs: &1.inputs ++ [port]})
    opts = %{type: :any, check: :off, counters: wiring.counters, sizes: wiring.sizes}
    input = Input.new(wiring.name, wiring.tag, wiring.producer, wiring.policy, opts)

    case wiring.end do
      {:closed, time} ->
        Step.put_input(step, Input.push_closed(input, time))

      {:open, _last} ->
        Input.request_first(input)
        Step.put_input(step, input)
    end
  end

  @doc "Removes the connection of an input that the component has detached."
  @spec remove_input(Step.t(), atom()) :: Step.t()
  def remove_input(step, name) do
    step = Step.update_head(step, &%{&1 | inputs: Keyword.delete(&1.inputs, name)})
    Step.report_event(step, {:detached, name, step.worker.opts})

    case Inputs.find_by_name(step.inputs, name) do
      nil ->
        step

      input ->
        Address.send_to_producer(input.producer, input.tag, {:cancel, :normal})
        Input.set_hold(input, false)
        %{step | inputs: Inputs.delete(step.inputs, input.tag)}
    end
  end
end
