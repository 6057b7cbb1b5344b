defmodule Situ.MapAsync.Component do
  @moduledoc false
  # Jobs are in the order of their messages, and the oldest decides when results can be emitted. A failed job becomes an
  # error when it is the oldest.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      fun: [type: :any, required: true],
      max: [type: :pos_integer, required: true],
      timeout: [type: :any, default: :infinity],
      errors: [type: {:in, [:stop, :skip, :restart]}, default: :stop]
    ]

  alias Situ.{Error, Runtime}

  @impl true
  def init(opts),
    do: {:ok, %{opts: Map.new(opts), jobs: :queue.new(), count: 0, done: %{}, failing: false}}

  @impl true
  def handle_message(:in, message, context, state) do
    ref = start_job(message, state.opts)
    jobs = :queue.in({ref, message.originating_time}, state.jobs)
    hold_or_resume(%{state | jobs: jobs, count: state.count + 1}, [], context)
  end

  defp start_job(message, %{fun: fun, timeout: timeout}) do
    me = self()

    {pid, ref} =
      Runtime.spawn_process(:erlang, "job", {__MODULE__, :run_job, [me, fun, message]}, [:monitor])

    if timeout != :infinity, do: Runtime.send_after({:situ_late, ref, pid}, timeout)
    ref
  end

  @doc false
  # The job ends with the component, even if the component is killed.
  def run_job(component, fun, message) do
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

  def handle_info({:hold_ended, :in}, context, state), do: hold_or_resume(state, [], context)

  # The error is a separate message, so that handling it undoes nothing else.
  def handle_info({:situ_failed, error}, _context, _state), do: raise(error)

  def handle_info(:situ_failed_job_done, context, state),
    do: emit_finished(%{state | failing: false}, [], context)

  def handle_info(_other, _context, state), do: {[], state}

  # No more messages will arrive, so this waits for all jobs in progress.
  @impl true
  def handle_closed(:in, _time, context, state) do
    state = await_jobs(state)
    {actions, state} = emit_finished(state, [], context)
    emit_remaining(actions, state, context)
  end

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

  # With `:stop` nothing follows an error; otherwise all other results do.
  defp emit_remaining(actions, %{failing: true, opts: %{errors: errors}} = state, context)
       when errors != :stop do
    {more, state} = emit_finished(%{state | failing: false}, [], context)
    emit_remaining(actions ++ more, state, context)
  end

  defp emit_remaining(actions, state, _context), do: {actions, state}

  @impl true
  def terminate(_reason, _state), do: :ok

  defp put_result(state, ref, {:situ_result, result}), do: put_in(state.done[ref], result)
  defp put_result(state, ref, reason), do: put_in(state.done[ref], {:failed, :exit, reason, []})

  # Emits finished results in order, oldest first.
  defp emit_finished(%{failing: true} = state, actions, _context),
    do: {Enum.reverse(actions), state}

  defp emit_finished(state, actions, context) do
    with {:value, {ref, time}} <- :queue.peek(state.jobs), %{^ref => result} <- state.done do
      state = %{
        state
        | jobs: :queue.drop(state.jobs),
          count: state.count - 1,
          done: Map.delete(state.done, ref)
      }

      case result do
        {:ok, value} ->
          emit_finished(state, [{:out, time, value} | actions], context)

        {:failed, kind, reason, stack} ->
          send(self(), {:situ_failed, job_error(kind, reason, stack, time, context, state.opts)})
          send(self(), :situ_failed_job_done)
          emit_finished(%{state | failing: true}, actions, context)
      end
    else
      _ -> hold_or_resume(state, actions, context)
    end
  end

  # When all slots are in use, the input is held so that the stream waits.
  defp hold_or_resume(%{count: count, opts: %{max: max}} = state, actions, _context) do
    action = if count >= max, do: {:hold, :in}, else: {:resume, :in}
    {Enum.reverse([action | actions]), state}
  end

  defp job_error(_kind, :killed, _stack, time, context, %{timeout: timeout})
       when timeout != :infinity do
    Error.new(:timeout, "#{context.path} did not finish within #{timeout} ms",
      why: "its function was still running for the message at #{time} ns",
      fix: "increase timeout:, or skip such messages with on_error: :skip",
      meta: %{component: context.path, originating_time: time}
    )
  end

  defp job_error(kind, reason, stack, time, context, _opts) do
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
