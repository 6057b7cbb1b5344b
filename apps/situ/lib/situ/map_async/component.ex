defmodule Situ.MapAsync.Component do
  @moduledoc false
  # Jobs are in the order of their messages, and the oldest decides when results can be emitted. A failed job becomes an
  # error when it is the oldest. Until then its message is in progress: if this process is killed, its jobs end, and the
  # next process starts them again.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      fun: [type: :any, required: true],
      max: [type: :pos_integer, required: true],
      timeout: [type: :any, default: :infinity]
    ]

  alias Situ.Component.LogContext
  alias Situ.{Error, Runtime}

  @impl true
  def init(opts),
    do: {:ok, %{opts: Map.new(opts), jobs: :queue.new(), count: 0, done: %{}, finished: nil}}

  @impl true
  def handle_message(:in, message, _context, state) do
    ref = start_job(message, state.opts)
    jobs = :queue.in({ref, message.originating_time}, state.jobs)
    report_progress(%{state | jobs: jobs, count: state.count + 1}, [])
  end

  defp start_job(message, %{fun: fun, timeout: timeout}) do
    args = [self(), fun, message, LogContext.capture()]
    {pid, ref} = Runtime.spawn_process(:erlang, "job", {__MODULE__, :run_job, args}, [:monitor])

    if timeout != :infinity, do: Runtime.send_after({:situ_late, ref, pid}, timeout)
    ref
  end

  @doc false
  # The job ends with the component, even if the component is killed.
  def run_job(component, fun, message, log_context) do
    LogContext.restore(log_context)

    Runtime.spawn_process(
      :erlang,
      "watch of a job",
      {__MODULE__, :watch_job, [component, self()]},
      []
    )

    exit({:situ_result, run_function(fun, message)})
  end

  @doc false
  def watch_job(component, job) do
    [a, b] = for pid <- [component, job], do: Process.monitor(pid)

    receive do
      {:DOWN, ^a, _, _, _} -> Process.exit(job, :kill)
      {:DOWN, ^b, _, _, _} -> :ok
    end
  end

  defp run_function(fun, message) when is_function(fun, 1),
    do: catch_failure(fn -> fun.(message.data) end)

  defp run_function(fun, message), do: catch_failure(fn -> fun.(message.data, message) end)

  defp catch_failure(fun) do
    {:ok, fun.()}
  catch
    kind, reason -> {:failed, kind, reason, __STACKTRACE__}
  end

  @impl true
  def handle_info({:DOWN, ref, :process, _pid, reason}, context, state),
    do: state |> put_result(ref, reason) |> emit_finished([], context)

  def handle_info({:situ_late, ref, pid}, _context, state) do
    if Enum.any?(:queue.to_list(state.jobs), &(elem(&1, 0) == ref)) and
         not is_map_key(state.done, ref),
       do: Process.exit(pid, :kill)

    {[], state}
  end

  def handle_info({:hold_ended, :in}, _context, state), do: report_progress(state, [])
  def handle_info(_other, _context, state), do: {[], state}

  # No more messages will arrive, so this waits for all jobs in progress.
  @impl true
  def handle_closed(:in, _time, context, state),
    do: state |> await_jobs() |> emit_finished([], context)

  defp await_jobs(state) do
    if map_size(state.done) == state.count do
      state
    else
      receive do
        {:DOWN, ref, :process, _pid, reason} ->
          await_jobs(put_result(state, ref, reason))

        {:situ_late, ref, pid} ->
          if not is_map_key(state.done, ref), do: Process.exit(pid, :kill)
          await_jobs(state)
      end
    end
  end

  @impl true
  def terminate(_reason, _state), do: :ok

  defp put_result(state, ref, {:situ_result, result}), do: put_in(state.done[ref], result)
  defp put_result(state, ref, reason), do: put_in(state.done[ref], {:failed, :exit, reason, []})

  # Emits finished results in order, oldest first. `actions` are reversed.
  defp emit_finished(state, actions, context) do
    with {:value, {ref, time}} <- :queue.peek(state.jobs), %{^ref => result} <- state.done do
      state = %{
        state
        | jobs: :queue.drop(state.jobs),
          count: state.count - 1,
          done: Map.delete(state.done, ref),
          finished: time
      }

      action = result_action(result, time, context, state.opts)
      emit_finished(state, [action | actions], context)
    else
      _ -> report_progress(state, actions)
    end
  end

  defp result_action({:ok, value}, time, _context, _opts), do: {:out, time, value}

  defp result_action({:failed, kind, reason, stack}, time, context, opts),
    do: {:error, job_error({kind, reason, stack}, time, context, opts)}

  # When all slots are in use, the input is held so that the stream waits.
  defp report_progress(%{count: count, opts: %{max: max}} = state, actions) do
    hold = if count >= max, do: {:hold, :in}, else: {:resume, :in}
    {Enum.reverse([{:in_progress, :in, count, state.finished}, hold | actions]), state}
  end

  defp job_error({_kind, :killed, _stack}, time, context, %{timeout: timeout})
       when timeout != :infinity do
    Error.new(:timeout, "#{context.path} did not finish within #{timeout} ms",
      why: "its function was still running for the message at #{time} ns",
      fix: "increase timeout:, or skip such messages with on_error: :skip",
      meta: %{component: context.path, originating_time: time}
    )
  end

  defp job_error({kind, reason, stack}, time, context, _opts) do
    Error.new(
      :component_failed,
      "#{context.path} failed: #{Exception.format_banner(kind, reason, stack)}",
      meta: %{
        component: context.path,
        kind: kind,
        exception: if(kind == :error, do: Exception.normalize(:error, reason, stack)),
        reason: reason,
        stacktrace: stack,
        originating_time: time
      }
    )
  end
end
