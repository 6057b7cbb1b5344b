defmodule Situ.Stage.ActionRunner do
  @moduledoc false
  # Applies a component's actions to the state of its stage: all of them, or none if one is invalid. Then
  # `send_pending/1` sends the messages.
  alias Situ.{Error, Message}
  alias Situ.Clock.Timers
  alias Situ.Component.Callback
  alias Situ.Ports.{Inputs, Output, Outputs, PostingRules}
  alias Situ.Stage.{ChainRunner, ErrorPolicy, Scheduling, SourceState, State}

  @spec apply_actions(State.t(), [Situ.Component.action()], Situ.Time.t()) ::
          {:ok, State.t()} | {:error, Error.t()}
  def apply_actions(state, [], _now), do: {:ok, state}

  def apply_actions(state, [{output, time, _} | _] = actions, now)
      when is_integer(time) and is_atom(output) and
             output not in [:timer, :close, :complete, :continue] do
    with {:ok, output} <- output(state, output),
         {:ok, output, rest} <-
           PostingRules.emit_all(
             output,
             actions,
             now,
             state.context.enforced?,
             state.source.final
           ),
         :ok <- PostingRules.in_range(output, time) do
      apply_actions(put(state, output), rest, now)
    end
  end

  def apply_actions(state, [{output, %Message{} = message} | rest], now) when is_atom(output),
    do: forward(state, output, [message], rest, now)

  def apply_actions(state, [{output, messages} | rest], now)
      when is_atom(output) and is_list(messages),
      do: forward(state, output, messages, rest, now)

  def apply_actions(state, [action | rest], now) do
    case one(state, action, now) do
      {:ok, state} -> apply_actions(state, rest, now)
      error -> error
    end
  end

  def apply_actions(state, other, _now),
    do: {:error, Callback.bad_action_error(state.callback.path, other)}

  defp forward(state, name, messages, rest, now) do
    with {:ok, output} <- output(state, name),
         {:ok, output} <-
           PostingRules.forward_all(output, messages, now, state.context.enforced?),
         :ok <- in_range(output, messages) do
      apply_actions(put(state, output), rest, now)
    else
      :error -> {:error, Callback.bad_action_error(state.callback.path, {name, messages})}
      error -> error
    end
  end

  defp in_range(_output, []), do: :ok
  defp in_range(output, [first | _]), do: PostingRules.in_range(output, first.originating_time)

  defp put(state, output), do: %{state | outputs: Outputs.put(state.outputs, output)}

  # An infinite source continues to produce, but no longer affects when the pipeline ends.
  defp one(state, {:complete, :infinity}, _now) do
    if not state.source.completed, do: State.report_event(state, {:completed, :infinity})
    {:ok, state}
  end

  defp one(state, {:complete, time}, _now) when is_integer(time),
    do: {:ok, announce_end(state, time)}

  defp one(state, {:close, name}, now) do
    with {:ok, output} <- output(state, name),
         do: {:ok, close(state, output, output.last_time || now)}
  end

  defp one(state, {:close, name, time}, _now) when is_integer(time) do
    with {:ok, output} <- output(state, name), do: {:ok, close(state, output, time)}
  end

  defp one(state, {:hold, input}, _now) when is_atom(input),
    do: {:ok, %{state | inputs: Inputs.set_hold(state.inputs, input, true)}}

  defp one(state, {:resume, input}, _now) when is_atom(input),
    do: {:ok, %{state | inputs: Inputs.set_hold(state.inputs, input, false)}}

  # The component may be in the middle of a message of the input: the connection is removed in the next turn.
  defp one(state, {:detach, input, opts}, _now) when is_atom(input) and is_list(opts) do
    send(self(), {:situ, {:leave, input}})
    {:ok, put_options(state, opts)}
  end

  defp one(%{source: %{final: final}} = state, {:timer, _key, time}, _now)
       when is_integer(time) and is_integer(final) and time > final,
       do: {:ok, state}

  defp one(state, {:timer, key, time}, _now) when is_integer(time),
    do: {:ok, %{state | timers: Timers.add(state.timers, time, key)}}

  defp one(state, {:continue, term}, _now),
    do: {:ok, %{state | pace: %{state.pace | continue: {:some, term}}}}

  defp one(state, {:linger, lingers?}, _now) when is_boolean(lingers?) do
    state = State.set_patience(state, lingers?)
    {:ok, %{state | pace: %{state.pace | lingers: lingers?}}}
  end

  defp one(state, {:demand, mode}, _now) when mode in [:accumulate, :forward],
    do: {:ok, State.set_demand(state, mode)}

  defp one(state, :stopping, _now),
    do: {:ok, %{state | source: SourceState.mark_stopping(state.source)}}

  defp one(%{source: %{stopping: :stopping}} = state, :stopped, _now),
    do: {:ok, ErrorPolicy.report_source_stopped(state)}

  defp one(state, :stopped, _now), do: {:ok, state}

  defp one(state, action, _now),
    do: {:error, Callback.bad_action_error(state.callback.path, action)}

  @doc "Replaces the component's options."
  @spec put_options(State.t(), keyword()) :: State.t()
  def put_options(state, opts) do
    state = State.put_head(state, %{State.head_vertex(state) | opts: opts})
    %{state | callback: %{state.callback | opts: opts}}
  end

  @doc "Records a source's end; the server is notified once no message waits for its time, before the rest is sent."
  @spec announce_end(State.t(), Situ.Time.t()) :: State.t()
  def announce_end(state, time) do
    {how, source} = SourceState.record_end(state.source, time, Outputs.any_held?(state.outputs))
    if how == :tell, do: State.report_event(state, {:completed, time})
    outputs = if how == :tell, do: Outputs.set_waiting(state.outputs, true), else: state.outputs
    %{state | source: source, outputs: outputs}
  end

  # The last output of a source that closes says that it ends, before the closing mark goes out.
  defp close(%{source: %{kind: nil}} = state, output, time), do: close_now(state, output, time)

  defp close(%{outputs: outputs} = state, output, time) do
    state = close_now(%{state | outputs: Outputs.set_waiting(outputs, true)}, output, time)

    closed(
      %{state | outputs: Outputs.set_waiting(state.outputs, Outputs.any_waiting?(outputs))},
      time
    )
  end

  # The light operators after a component close with it.
  defp close_now(%{outputs: %{tail: %Output{}}} = state, _output, time) do
    state = send_all_pending(state)
    %{state | outputs: Outputs.map_outputs(state.outputs, &Output.close(&1, time))}
  end

  defp close_now(state, output, time) do
    {:ok, output} = Outputs.fetch(state.outputs, output.port.name)
    put(state, Output.close(output, time))
  end

  defp closed(state, time) do
    closing = for output <- Outputs.list_all(state.outputs), do: output.closing
    if nil in closing, do: state, else: announce_end(state, Enum.max([time | closing]))
  end

  defp output(state, name) do
    case Outputs.fetch(state.outputs, name) do
      {:ok, output} -> {:ok, output}
      :error -> {:error, unknown_output(state, name)}
    end
  end

  defp unknown_output(state, name) do
    known = state.outputs |> Outputs.list_names() |> Enum.map_join(", ", &inspect/1)

    Error.new(
      :unknown_output,
      "#{state.callback.path} emitted on #{inspect(name)}, but it has no such output",
      fix: "its outputs: " <> known,
      meta: %{component: state.callback.path}
    )
  end

  @doc """
  Sends pending messages, publishes counts and requests more messages. Slow operators after a component leave
  messages for another time slice, after the current mailbox.
  """
  @spec send_pending(State.t()) :: State.t()
  def send_pending(%{callback: nil} = state),
    do: %{
      state
      | outputs: Outputs.flush(state.outputs),
        inputs: Inputs.settle_touched(state.inputs)
    }

  def send_pending(state) do
    state = state |> ChainRunner.run_tail(:some) |> sent()

    if state.outputs.left == [],
      do: state,
      else: %{state | pace: Scheduling.schedule_slice(state.pace)}
  end

  @doc "Settles and leaves no messages, for a stage that closes or pauses."
  @spec send_all_pending(State.t()) :: State.t()
  def send_all_pending(%{callback: nil} = state), do: send_pending(state)
  def send_all_pending(state), do: state |> ChainRunner.run_tail(:all) |> sent()

  defp sent(state) do
    state = widen(state)
    %{state | outputs: flush(state), inputs: Inputs.settle_touched(state.inputs)}
  end

  # Messages that a source posts before the clock starts wait for the light operators after it.
  defp flush(%{outputs: %{tail: %Output{}} = outputs, phase: :starting}), do: outputs
  defp flush(%{outputs: outputs}), do: Outputs.flush(outputs)

  defp widen(%{pace: %{wide: true}} = state), do: state

  defp widen(%{pace: pace} = state),
    do: %{state | pace: Scheduling.enlarge_heap(pace, Inputs.max_handled(state.inputs))}
end
