defmodule Situ.Stage.ActionRunner do
  @moduledoc false
  # Applies a component's actions to its step: all of them, or none if one is invalid.
  alias Situ.{Columns, Error, Message}
  alias Situ.Columns.Validation
  alias Situ.Clock.Timers
  alias Situ.Component.Callback
  alias Situ.Ports.{Dispatcher, Inputs, Output, Outputs, PostingRules}
  alias Situ.Stage.{ErrorPolicy, SourceState, Step}

  @compile {:inline, fetch_output: 2, put_output: 2}

  @spec apply_actions(Step.t(), [Situ.Component.action()]) ::
          {:ok, Step.t()} | {:error, Error.t()}
  def apply_actions(step, []), do: {:ok, step}

  def apply_actions(step, [{name, time, _} | _] = actions)
      when is_integer(time) and is_atom(name) and
             name not in [:timer, :close, :complete, :continue] do
    %{context: %{enforced?: enforced?, now: now}, source: %{final: final}} = step

    with {:ok, output} <- fetch_output(step, name),
         {:ok, output, rest} <- PostingRules.emit_all(output, actions, now, enforced?, final),
         :ok <- PostingRules.check_range(output, time) do
      apply_actions(put_output(step, output), rest)
    end
  end

  def apply_actions(step, [{name, [first | _] = times, data} = action | rest])
      when is_atom(name) and is_list(data) do
    %{context: %{enforced?: enforced?, now: now}, source: %{final: final}} = step
    emit = &PostingRules.emit_lists(&1, {times, data}, now, enforced?, final)
    post_together(step, {action, first}, rest, emit)
  end

  def apply_actions(step, [{name, %Columns{} = columns} = action | rest]) when is_atom(name) do
    %{context: %{enforced?: enforced?, now: now}, source: %{final: final}} = step

    with :ok <- Validation.validate(columns) do
      emit = &PostingRules.emit_columns(&1, columns, now, enforced?, final)
      post_together(step, {action, Columns.first_time(columns)}, rest, emit)
    end
  end

  def apply_actions(step, [{name, %Message{} = message} | rest]) when is_atom(name),
    do: forward(step, name, [message], rest)

  def apply_actions(step, [{name, messages} | rest])
      when is_atom(name) and is_list(messages),
      do: forward(step, name, messages, rest)

  def apply_actions(step, [{:error, %Error{} = error} | rest]) do
    case ErrorPolicy.report_failure(step, error) do
      %{phase: :failed} = step -> {:ok, step}
      step -> apply_actions(step, rest)
    end
  end

  def apply_actions(step, [action | rest]) do
    with {:ok, step} <- apply_action(step, action), do: apply_actions(step, rest)
  end

  def apply_actions(step, other), do: {:error, bad_action(step, other)}

  defp forward(step, name, [], rest),
    do: with({:ok, _output} <- fetch_output(step, name), do: apply_actions(step, rest))

  defp forward(%{context: context} = step, name, [first | _] = messages, rest) do
    emit = &PostingRules.forward_all(&1, messages, context.now, context.enforced?)
    time = with %Message{originating_time: time} <- first, do: time
    post_together(step, {{name, messages}, time}, rest, emit)
  end

  # `first` is the time of the first message of the action.
  defp post_together(step, {action, first}, rest, emit) do
    with {:ok, output} <- fetch_output(step, elem(action, 0)),
         {:ok, output} <- emit.(output),
         :ok <- PostingRules.check_range(output, first) do
      apply_actions(put_output(step, output), rest)
    else
      :error -> {:error, bad_action(step, action)}
      error -> error
    end
  end

  defp put_output(step, output), do: %{step | outputs: Outputs.put(step.outputs, output)}

  # An infinite source continues to produce, but no longer affects when the pipeline ends.
  defp apply_action(step, {:complete, :infinity}) do
    if not step.source.completed, do: Step.report_event(step, {:completed, :infinity})
    {:ok, step}
  end

  defp apply_action(step, {:complete, time}) when is_integer(time),
    do: {:ok, announce_end(step, time)}

  defp apply_action(step, {:close, name}) do
    with {:ok, output} <- fetch_output(step, name),
         do: {:ok, close_output(step, output, output.last_time || step.context.now)}
  end

  defp apply_action(step, {:close, name, time}) when is_integer(time) do
    with {:ok, output} <- fetch_output(step, name), do: {:ok, close_output(step, output, time)}
  end

  defp apply_action(step, {how, input}) when how in [:hold, :resume] and is_atom(input),
    do: {:ok, %{step | inputs: Inputs.set_hold(step.inputs, input, how == :hold)}}

  defp apply_action(step, {:in_progress, input, n, until})
       when is_atom(input) and is_integer(n) and n >= 0 and (is_integer(until) or until == nil),
       do: {:ok, %{step | inputs: Inputs.put_progress(step.inputs, input, {n, until})}}

  # The component may be handling a message of this input, so the connection is removed in the next time slice.
  defp apply_action(step, {:detach, input, opts}) when is_atom(input) and is_list(opts) do
    Step.send_to_stage(step.host, {:situ, {:leave, input}})
    {:ok, Step.put_options(step, opts)}
  end

  defp apply_action(%{source: %{final: final}} = step, {:timer, _key, time})
       when is_integer(time) and is_integer(final) and time > final,
       do: {:ok, step}

  defp apply_action(step, {:timer, key, time}) when is_integer(time),
    do: {:ok, %{step | timers: Timers.add(step.timers, time, key)}}

  defp apply_action(step, {:continue, term}),
    do: {:ok, %{step | work: %{step.work | continue: {:some, term}}}}

  defp apply_action(step, {:linger, lingers?}) when is_boolean(lingers?) do
    Step.set_patience(step, lingers?)
    {:ok, %{step | work: %{step.work | lingers: lingers?}}}
  end

  defp apply_action(step, {:demand, mode}) when mode in [:accumulate, :forward],
    do: {:ok, Step.set_demand(step, mode)}

  defp apply_action(step, {:dispatcher, spec}) do
    with {:ok, dispatcher} <- Dispatcher.new(spec) do
      Step.set_patience(step, true)
      {:ok, %{step | outputs: Outputs.put_dispatcher(step.outputs, dispatcher)}}
    end
  end

  defp apply_action(step, :stopping),
    do: {:ok, %{step | source: SourceState.mark_stopping(step.source)}}

  defp apply_action(%{source: %{stopping: :stopping}} = step, :stopped),
    do: {:ok, ErrorPolicy.report_source_stopped(step)}

  defp apply_action(step, :stopped), do: {:ok, step}
  defp apply_action(step, action), do: {:error, bad_action(step, action)}

  defp bad_action(step, action), do: Callback.bad_action_error(step.worker.path, action)

  @doc "Records a source's end; the server is notified once no message waits for its time, before the rest is sent."
  @spec announce_end(Step.t(), Situ.Time.t()) :: Step.t()
  def announce_end(step, time) do
    case SourceState.record_end(step.source, time, Outputs.any_held?(step.outputs)) do
      {:tell, source} ->
        Step.report_event(step, {:completed, time})
        %{step | source: source, outputs: Outputs.set_withheld(step.outputs, true)}

      {:later, source} ->
        %{step | source: source}
    end
  end

  # If all outputs of a source close, the server learns of its end before the closing mark is sent.
  defp close_output(step, output, time) do
    step = put_output(step, Output.close(output, time))
    closing = for output <- Outputs.list_all(step.outputs), do: Output.closing_time(output)

    if step.source.kind == nil or nil in closing,
      do: step,
      else: announce_end(step, Enum.max([time | closing]))
  end

  defp fetch_output(step, name) do
    with :error <- Outputs.fetch(step.outputs, name),
         do: {:error, Step.unknown_output(step, name)}
  end
end
