defmodule Situ.Python.Component do
  @moduledoc false
  # Hands messages to a Python worker and emits its results, in order. Several messages are in flight, as many as the
  # worker handles in about 5 ms; while there are more, the inputs are held, so the streams wait.
  #
  # An error is a separate message to this process, so that handling it undoes nothing else (as in `Situ.MapAsync`). The
  # message at which Python failed is lost. With `:skip` and `:restart`, later messages without a result are sent again.
  use Situ.Component

  alias Situ.Error
  alias Situ.Python.{Launch, Program, Protocol, Requests, Window, Worker}

  # A restart begins with a new state, so the process keeps here which inputs are open, the last time, and the messages
  # to handle again.
  @kept {__MODULE__, :kept}
  # After a worker could not be replaced, the next attempt follows in this time, ms.
  @retry 1_000

  @impl true
  def options do
    Launch.options() ++
      [input_names: [type: :any, required: true], grouped: [type: :boolean, required: true]]
  end

  @impl true
  def init(opts) do
    opts = Map.new(opts)
    numbers = opts.input_names |> Enum.with_index() |> Map.new()

    {:ok,
     %{
       opts: opts,
       numbers: numbers,
       open: opts.input_names,
       worker: nil,
       process: nil,
       version: nil,
       in_flight: :queue.new(),
       window: Window.new(opts.batch),
       last_time: nil,
       lost: [],
       held?: false
     }}
  end

  @impl true
  def handle_start(context, state) do
    {kept, entries} = Process.delete(@kept) || {%{}, []}
    state = Map.merge(state, kept)

    # After the end of all inputs, errors that were reported late restart the component once more.
    if state.open == [] do
      keep_for_restart(state)
      {[], state}
    else
      lost = Enum.flat_map(state.lost, &group_results(state, {nil, &1, nil}, []))
      {lost, %{state | lost: []} |> start_worker!(context) |> submit(entries)}
    end
  end

  defp keep_for_restart(state) do
    kept = {Map.take(state, [:open, :last_time, :lost]), :queue.to_list(state.in_flight)}
    Process.put(@kept, kept)
  end

  defp start_worker!(state, context), do: state |> start_worker(context) |> Error.unwrap!()

  defp start_worker(state, context) do
    with {:ok, launched} <- Launch.start_worker(state.opts, context),
         do: {:ok, Map.merge(state, launched)}
  end

  @impl true
  def handle_message(input, message, context, state) do
    hold_or_resume([], submit(state, [build_entry(input, message, context, state)]))
  end

  @doc "Handles several messages of the only input."
  @spec handle_batch(atom(), [Situ.Message.t()], Situ.Component.Context.t(), map()) ::
          {[Situ.Component.action()], map()}
  def handle_batch(input, messages, context, state) do
    entries = Enum.map(messages, &build_entry(input, &1, context, state))
    hold_or_resume([], submit(state, entries))
  end

  defp build_entry(input, message, context, state),
    do: {input, message.originating_time, encode_message(input, message, context, state)}

  defp encode_message(input, message, context, state) do
    case Protocol.encode_value(message.data) do
      {:ok, value} -> {Protocol.encode_head(state.numbers[input], message), value}
      :error -> raise not_sendable_error(message.data, context)
    end
  end

  defp not_sendable_error(data, context) do
    Error.new(:not_writable, "#{context.path} cannot send #{inspect(data, limit: 5)} to Python",
      why: "it contains functions, processes or references",
      fix: "map the stream to numbers, strings, lists, maps or structs first"
    )
  end

  defp submit(state, entries) do
    if state.worker, do: Worker.send_messages(state.worker, Enum.map(entries, &elem(&1, 2)))
    window = Window.count_sent(state.window, length(entries))
    %{state | in_flight: Enum.reduce(entries, state.in_flight, &:queue.in/2), window: window}
  end

  # The worker takes no more messages than it handles soon.
  defp hold_or_resume(actions, state) do
    hold? = state.worker == nil or state.window.full?
    if hold? == state.held?, do: {actions, state}, else: set_hold(actions, hold?, state)
  end

  defp set_hold(actions, hold?, state) do
    action = if hold?, do: :hold, else: :resume
    {actions ++ for(input <- state.open, do: {action, input}), %{state | held?: hold?}}
  end

  @impl true
  def handle_info({:situ_python, worker, event}, context, %{worker: worker} = state) do
    {actions, state} = handle_event(event, context, state)
    hold_or_resume(actions, state)
  end

  # A hold ends by itself after 20 ms.
  def handle_info({:hold_ended, input}, _context, state),
    do: {if(state.held?, do: [{:hold, input}], else: []), state}

  def handle_info({:situ_python_failed, error}, _context, state) do
    if state.opts.errors == :restart, do: keep_for_restart(state)
    raise error
  end

  def handle_info({:EXIT, worker, reason}, context, %{worker: worker} = state)
      when reason != :normal,
      do:
        handle_info({:situ_python, worker, {:ended, Launch.crash_error(reason)}}, context, state)

  def handle_info(:situ_python_again, context, %{worker: nil, open: [_ | _]} = state) do
    case start_again(state, context) do
      {:ok, state} ->
        hold_or_resume([], state)

      {:error, error} ->
        send(self(), {:situ_python_failed, add_subject(error, context, "")})
        Process.send_after(self(), :situ_python_again, @retry)
        {[], state}
    end
  end

  def handle_info(_other, _context, state), do: {[], state}

  defp handle_event({:results, results, spent_ns}, context, state) do
    window = Window.adapt(state.window, length(results), spent_ns)
    take_results(results, [], context, %{state | window: window})
  end

  defp handle_event({:ended, error}, context, state),
    do: handle_failure(%{state | worker: nil}, error, context)

  defp handle_event(_event, _context, state), do: {[], state}

  defp take_results([], actions, _context, state), do: {Enum.reverse(actions), state}

  defp take_results([{:ok, emitted} | rest], actions, context, state) do
    grouped = group_results(state, oldest(state), emitted)
    state = state |> drop_oldest() |> record_times(grouped)
    take_results(rest, Enum.reverse(grouped, actions), context, state)
  end

  defp take_results([{:error, error} | rest], actions, context, state) do
    if state.opts.errors == :skip do
      send(self(), {:situ_python_failed, describe_error(error, oldest(state), context)})
      lost = group_results(state, oldest(state), [])
      take_results(rest, lost ++ actions, context, drop_oldest(state))
    else
      # After an exception, Python ignores further messages.
      stop_worker(state)
      {lost, state} = handle_failure(%{state | worker: nil}, error, context)
      {Enum.reverse(actions, lost), state}
    end
  end

  # One of several workers emits exactly one message for each input message, with all its results
  # (`Situ.Python.Workers`).
  defp group_results(%{opts: %{grouped: true}}, {_input, time, _message}, emitted),
    do: [{:results, time, emitted}]

  defp group_results(_state, _entry, emitted), do: emitted

  # With `:skip`, the component keeps its state and gets a new worker. With `:restart`, the runtime starts it again.
  defp handle_failure(state, error, context) do
    entry = oldest(state)
    send(self(), {:situ_python_failed, describe_error(error, entry, context)})
    lost = group_results(state, entry, [])
    state = drop_oldest(state)

    case state.opts.errors do
      :skip ->
        send(self(), :situ_python_again)
        {lost, state}

      # A restart discards the current outputs.
      _restart_or_stop ->
        {[], %{state | lost: state.lost ++ for({_output, time, _} <- lost, do: time)}}
    end
  end

  defp start_again(state, context) do
    empty = %{state | in_flight: :queue.new(), window: Window.new(state.opts.batch)}

    with {:ok, started} <- start_worker(empty, context),
         do: {:ok, submit(started, :queue.to_list(state.in_flight))}
  end

  defp oldest(state) do
    case :queue.peek(state.in_flight) do
      {:value, entry} -> entry
      :empty -> nil
    end
  end

  defp drop_oldest(state) do
    if :queue.is_empty(state.in_flight),
      do: state,
      else: %{
        state
        | in_flight: :queue.drop(state.in_flight),
          window: Window.count_done(state.window)
      }
  end

  defp record_times(state, emitted) do
    Enum.reduce(emitted, state, fn {_output, time, _value}, state ->
      %{state | last_time: max(time, state.last_time || time)}
    end)
  end

  defp describe_error(error, nil, context), do: add_subject(error, context, "")

  defp describe_error(error, {input, time, _message}, context) do
    meta = Map.merge(error.meta, %{input: input, originating_time: time})

    add_subject(
      %{error | meta: meta},
      context,
      " for the message of #{input} at #{Situ.Time.to_iso8601(time)}"
    )
  end

  defp add_subject(error, context, place),
    do: %{error | what: "#{context.path} failed#{place}: #{error.what}"}

  # No more messages will arrive, so this waits for all results.
  @impl true
  def handle_closed(input, time, context, state) do
    state = %{state | open: state.open -- [input]}
    if state.open == [], do: finish(time, context, state), else: {[], state}
  end

  defp finish(time, context, %{worker: worker} = state) when worker != nil do
    Worker.send_close(worker, time)
    await_results([], time, context, state)
  end

  defp finish(_time, _context, %{opts: %{errors: :stop}} = state), do: {[], state}
  # The worker has failed, and the component has not been restarted yet.
  defp finish(time, context, state) do
    finish(time, context, state |> start_again(context) |> Error.unwrap!())
  end

  defp await_results(actions, time, context, state) do
    case receive_event(state.worker) do
      {:closed, result} ->
        {emitted, state} = close_result(result, time, context, state)
        {actions ++ emitted, state}

      event ->
        {emitted, state} = handle_event(event, context, state)
        await_more(actions ++ emitted, time, context, state)
    end
  end

  # The worker limits the time of each message.
  defp receive_event(worker) do
    receive do
      {:situ_python, ^worker, event} -> event
      {:EXIT, ^worker, reason} when reason != :normal -> {:ended, Launch.crash_error(reason)}
    end
  end

  # With `:stop` nothing follows an error; otherwise all other results do.
  defp await_more(actions, _time, _context, %{worker: nil, opts: %{errors: :stop}} = state),
    do: {actions, state}

  defp await_more(actions, time, context, %{worker: nil} = state) do
    {more, state} = finish(time, context, state)
    {actions ++ more, state}
  end

  defp await_more(actions, time, context, state), do: await_results(actions, time, context, state)

  # The values of `on_close` without a time follow all others.
  defp close_result({:ok, emitted}, time, _context, state) do
    later = if state.last_time, do: max(time, state.last_time + 1), else: time

    last =
      for {output, at, value} <- emitted,
          do: {output, if(at == time, do: later, else: at), value}

    grouped? = state.opts.grouped and last != []
    {if(grouped?, do: [{:results, later, {:closing, last}}], else: last), state}
  end

  defp close_result({:error, error}, _time, context, state),
    do: handle_failure(%{state | in_flight: :queue.new()}, error, context)

  @impl true
  def terminate(_reason, state), do: stop_worker(state)

  defp stop_worker(%{worker: nil}), do: :ok
  defp stop_worker(%{worker: worker}), do: Worker.stop(worker)

  # Results that arrive before the reply are emitted first.
  @impl true
  def snapshot(state) do
    case Requests.call_worker(state.worker, Protocol.encode_snapshot()) do
      {:ok, bytes, []} -> {:ok, state |> Map.take([:open, :last_time]) |> Map.put(:python, bytes)}
      {:ok, _bytes, _events} -> {:error, Requests.not_settled_error()}
      {:error, error} -> {:error, Requests.no_snapshot_error(state.opts.class, error)}
    end
  end

  @impl true
  def restore(data, fresh) do
    frame = Protocol.encode_restore(data.python)

    # After a stop, all inputs had closed, and all of them are open again.
    open = if data.open == [], do: fresh.open, else: data.open

    with {:ok, _reply, _events} <- Requests.call_worker(fresh.worker, frame),
         do: {:ok, %{fresh | open: open, last_time: data.last_time}}
  end

  @impl true
  def describe(%{worker: nil} = state), do: "#{state.opts.class}, not running"

  def describe(state) do
    "#{state.opts.class}, #{Program.describe_process(state.process, state.version)}, " <>
      "#{:queue.len(state.in_flight)} messages in flight"
  end
end
