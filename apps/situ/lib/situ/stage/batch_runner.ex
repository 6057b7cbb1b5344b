defmodule Situ.Stage.BatchRunner do
  @moduledoc false
  # Runs several messages together through a step: through a component with `handle_messages/4` or
  # `handle_columns/4`, or a chain.
  alias Situ.Component.Callback
  alias Situ.Delivery.Batch
  alias Situ.Operator.Chain
  alias Situ.Ports.{Input, Output, Outputs}
  alias Situ.Stage.{CallbackRunner, ErrorPolicy, Step}
  require Chain

  @compile {:inline, drop_late: 3, return_rest: 3}

  @doc """
  Runs a batch that was taken from `input`. It is `started` now, and a chain runs no longer than the `deadline`, both
  monotonic times (ns); the rest of the batch returns to the input. `:yield` means that the time is up.
  """
  @spec run_batch(Step.t(), Input.t(), Batch.t(), {integer(), integer() | :never}) ::
          {:more | :yield, Step.t()}
  def run_batch(step, input, batch, {started, _deadline} = times) do
    {batch, input} = drop_late(batch, input, Step.final_time(step))
    step = Step.read_clock(step)

    case {batch, step.worker} do
      {nil, _worker} -> {:more, Step.put_input(step, input)}
      {batch, %Chain{}} -> run_chain(step, input, batch, times)
      {batch, %Callback{}} -> step |> Step.put_input(input) |> call_batch(input, batch, started)
    end
  end

  # Messages later than the final time of a pipeline that stops do not count.
  defp drop_late(batch, input, final) do
    if final == Step.no_final_time() do
      {batch, input}
    else
      {batch, late} = Batch.split_after(batch, final)
      {batch, if(late, do: Input.drop_taken(input, Batch.size(late)), else: input)}
    end
  end

  defp call_batch(%{worker: worker} = step, %{name: name, tag: tag}, batch, started) do
    with {:ok, actions, core} <- Callback.run_handle_batch(worker, name, batch, step.context),
         {:ok, step} <- CallbackRunner.try_result(step, core, actions) do
      {:more, count_batch(step, Map.fetch!(step.inputs.by_tag, tag), {batch, nil}, started)}
    else
      # All messages are handled one by one, before another batch is tried.
      _error ->
        input = Input.put_back(Map.fetch!(step.inputs.by_tag, tag), batch)
        work = %{step.work | singly: Batch.size(batch)}
        {:more, Step.put_input(%{step | work: work}, input)}
    end
  end

  # Counts the part of a batch that was handled, and returns the other one to the input.
  defp count_batch(step, input, {done, rest}, started) do
    n = Batch.size(done)
    taken = if rest, do: n + Batch.size(rest), else: n
    step = Step.count_handled(step, n, taken, started)
    input = Input.count_handled(input, n, Batch.last_time(done), step.context.now)
    Step.put_input(step, return_rest(input, rest, step.phase))
  end

  defp return_rest(input, nil, _phase), do: input
  defp return_rest(input, rest, :failed), do: Input.drop_taken(input, Batch.size(rest))
  defp return_rest(input, rest, _phase), do: Input.put_back(input, rest)

  # Two messages are not worth a look at the time.
  defp run_chain(step, input, batch, {started, deadline}) do
    till = if Batch.size(batch) > 2, do: Step.vm_deadline(step, deadline), else: :never
    path = hd(step.vertices).path
    Process.put(:situ_handling, {path, batch})
    {results, chain, outcome} = Chain.run_batch(step.worker, batch, till)
    # A chain that waits must not keep the data of its last batch.
    Process.put(:situ_handling, {path, nil})
    Process.delete(:situ_left)
    step = %{step | worker: chain}

    case split_handled(batch, results, outcome) do
      {done, nil, nil} ->
        {:more, step |> post_results(results, done) |> count_batch(input, {done, nil}, started)}

      {done, nil, rest} ->
        {:yield, step |> post_results(results, done) |> count_batch(input, {done, rest}, started)}

      {done, message, rest} ->
        step = step |> post_results(results, done) |> fail_operator(outcome, message)
        done = if done, do: Batch.messages(done) ++ [message], else: [message]
        {:more, count_batch(step, input, {done, rest}, started)}
    end
  end

  # Returns the messages with a result, the message at which an operator failed, and the others.
  defp split_handled(batch, _results, :done), do: {batch, nil, nil}

  defp split_handled(batch, results, :late) do
    {done, rest} = Batch.split(batch, length(results))
    {done, nil, rest}
  end

  defp split_handled(batch, [], _failure) do
    {message, rest} = Batch.pop(batch)
    {nil, message, rest}
  end

  defp split_handled(batch, results, _failure) do
    {done, rest} = Batch.split(batch, length(results))
    {message, rest} = Batch.pop(rest)
    {done, message, rest}
  end

  defp post_results(step, _results, nil), do: step

  defp post_results(step, results, batch) do
    %{own: [{_name, output}]} = step.outputs
    {times, results} = drop_skipped(step.worker, Batch.times(batch), results)
    columns = {Batch.base(batch), times, results}
    last = Batch.last_time(batch)
    output = Output.post_results(output, last, columns, step.context.now)
    %{step | outputs: Outputs.put(step.outputs, output)}
  end

  defp drop_skipped(%{skips?: false}, times, results), do: {times, results}

  defp drop_skipped(_chain, times, results) do
    if :lists.member(Chain.skip(), results),
      do: drop_skipped(times, results, [], []),
      else: {times, results}
  end

  defp drop_skipped([], [], times, results), do: {:lists.reverse(times), :lists.reverse(results)}

  defp drop_skipped([_ | times], [Chain.skip() | results], kept, data),
    do: drop_skipped(times, results, kept, data)

  defp drop_skipped([time | times], [result | results], kept, data),
    do: drop_skipped(times, results, [time | kept], [result | data])

  defp fail_operator(step, {:situ_step, index, kind, reason, stack}, message) do
    vertex = Enum.at(step.vertices, index - step.index)

    error =
      vertex.path
      |> Callback.exception_error(:in, kind, reason, stack)
      |> Callback.add_message_info(:in, message)

    case vertex.on_error do
      :stop ->
        ErrorPolicy.fail_step(step, error)

      :skip ->
        ErrorPolicy.skip_message(step, error, index)

      :restart ->
        step = ErrorPolicy.record_restart(step, error, index)
        %{step | worker: Chain.replace_step(step.worker, index, vertex.opts)}
    end
  end
end
