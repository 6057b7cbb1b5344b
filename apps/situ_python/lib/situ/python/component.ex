defmodule Situ.Python.Component do
  @moduledoc false
  # Hands messages to a Python worker and emits its results, in order. Several messages are in flight, as many as the
  # worker handles in about 5 ms; while there are more, the inputs are held, so the streams wait.
  #
  # The message at which Python failed is lost. With `:skip` and `:restart`, later messages without a result are sent
  # again: to the next worker, or from the producer if this process was killed.
  use Situ.Component

  alias Situ.Error
  alias Situ.Python.{Launch, Program, Protocol, Requests, Window, Worker}

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
       progress: %{},
       held?: false
     }}
  end

  @impl true
  def handle_start(context, state),
    do: {[], state |> start_worker(context) |> Error.unwrap!()}

  defp start_worker(state, context) do
    with {:ok, launched} <- Launch.start_worker(state.opts, context),
         do: {:ok, Map.merge(state, launched)}
  end

  @impl true
  def handle_message(input, message, context, state),
    do: handle_batch(input, [message], context, state)

  @doc "Handles several messages of one input."
  @spec handle_batch(atom(), [Situ.Message.t()], Situ.Component.Context.t(), map()) ::
          {[Situ.Component.action()], map()}
  def handle_batch(input, messages, context, state) do
    entries = Enum.map(messages, &{input, &1.originating_time, encode_message(input, &1, state)})
    {actions, state} = state |> submit(entries) |> report_unsendable([], context)
    report_progress(Enum.reverse(actions), state)
  end

  defp encode_message(input, message, state) do
    case Protocol.encode_value(message.data) do
      {:ok, value} -> {Protocol.encode_head(state.numbers[input], message), value}
      :error -> not_sendable_error(message.data)
    end
  end

  defp not_sendable_error(data) do
    Error.new(:not_writable, "#{inspect(data, limit: 5)} cannot be sent to Python",
      why: "it contains functions, processes or references",
      fix: "map the stream to numbers, strings, lists, maps or structs first"
    )
  end

  # Sends messages, and remembers them until their results arrive.
  defp submit(state, entries) do
    sendable = for {_input, _time, {_head, _value} = message} <- entries, do: message
    if state.worker, do: Worker.send_messages(state.worker, sendable)
    window = Window.count_sent(state.window, length(sendable))
    progress = Enum.reduce(entries, state.progress, &count_begun/2)
    in_flight = Enum.reduce(entries, state.in_flight, &:queue.in/2)
    %{state | in_flight: in_flight, window: window, progress: progress}
  end

  defp count_begun({input, _time, _message}, progress),
    do: Map.update(progress, input, {1, nil}, fn {n, until} -> {n + 1, until} end)

  # The worker takes no more messages than it handles soon.
  defp report_progress(actions, state) do
    hold? = state.worker == nil or state.window.full?
    progress = for {input, {n, until}} <- state.progress, do: {:in_progress, input, n, until}
    holds = if hold? == state.held?, do: [], else: hold_actions(state.open, hold?)
    {actions ++ progress ++ holds, %{state | held?: hold?}}
  end

  defp hold_actions(inputs, hold?),
    do: for(input <- inputs, do: {if(hold?, do: :hold, else: :resume), input})

  @impl true
  def handle_info({:situ_python, worker, event}, context, %{worker: worker} = state) do
    {actions, state} = handle_event(event, context, state)
    report_progress(actions, state)
  end

  # A hold ends by itself after 20 ms.
  def handle_info({:hold_ended, input}, _context, state),
    do: {if(state.held?, do: [{:hold, input}], else: []), state}

  def handle_info({:EXIT, worker, reason}, context, %{worker: worker} = state)
      when reason != :normal,
      do:
        handle_info({:situ_python, worker, {:ended, Launch.crash_error(reason)}}, context, state)

  def handle_info(:situ_python_again, context, %{worker: nil, open: [_ | _]} = state) do
    case start_again(state, context) do
      {:ok, state} ->
        report_progress([], state)

      {:error, error} ->
        Process.send_after(self(), :situ_python_again, @retry)
        {[{:error, add_subject(error, context, "")}], state}
    end
  end

  def handle_info(_other, _context, state), do: {[], state}

  defp handle_event({:results, results, spent_ns}, context, state) do
    window = Window.adapt(state.window, length(results), spent_ns)
    take_results(results, [], context, %{state | window: window})
  end

  defp handle_event({:ended, error}, context, state) do
    {actions, state} = replace_worker([], error, context, %{state | worker: nil})
    {Enum.reverse(actions), state}
  end

  defp handle_event(_event, _context, state), do: {[], state}

  # `actions` are reversed.
  defp take_results([], actions, _context, state), do: {Enum.reverse(actions), state}

  defp take_results([{:ok, emitted} | rest], actions, context, state) do
    grouped = group_results(state, oldest(state), emitted)
    state = state |> drop_oldest() |> record_times(grouped)
    {actions, state} = report_unsendable(state, Enum.reverse(grouped, actions), context)
    take_results(rest, actions, context, state)
  end

  defp take_results([{:error, error} | rest], actions, context, %{opts: %{errors: :skip}} = state) do
    {actions, state} = report_error(actions, error, context, state)
    take_results(rest, actions, context, state)
  end

  # After an exception, Python ignores further messages.
  defp take_results([{:error, error} | _rest], actions, context, state) do
    stop_worker(state)
    {actions, state} = replace_worker(actions, error, context, %{state | worker: nil})
    {Enum.reverse(actions), state}
  end

  # Reports that the oldest message is lost, and the messages after it that could not be sent.
  defp report_error(actions, error, context, state) do
    entry = oldest(state)
    lost = Enum.reverse(group_results(state, entry, []), actions)
    actions = [{:error, describe_error(error, entry, context)} | lost]
    state |> drop_oldest() |> report_unsendable(actions, context)
  end

  defp report_unsendable(state, actions, context) do
    case oldest(state) do
      {_input, _time, %Error{} = error} -> report_error(actions, error, context, state)
      _sent_or_none -> {actions, state}
    end
  end

  # One of several workers emits exactly one message for each input message, with all its results
  # (`Situ.Python.Workers`).
  defp group_results(%{opts: %{grouped: true}}, {_input, time, _message}, emitted),
    do: [{:results, time, emitted}]

  defp group_results(_state, _entry, emitted), do: emitted

  # The next worker begins with the message after the one at which this worker has failed.
  defp replace_worker(actions, error, context, state) do
    send(self(), :situ_python_again)
    report_error(actions, error, context, state)
  end

  defp start_again(state, context) do
    window = Window.new(state.opts.batch)
    progress = Map.new(state.progress, fn {input, {_n, until}} -> {input, {0, until}} end)
    empty = %{state | in_flight: :queue.new(), window: window, progress: progress}

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
    case :queue.out(state.in_flight) do
      {:empty, _in_flight} ->
        state

      {{:value, {input, time, message}}, in_flight} ->
        sent? = is_tuple(message)
        window = if sent?, do: Window.count_done(state.window), else: state.window
        progress = Map.update!(state.progress, input, fn {n, _until} -> {n - 1, time} end)
        %{state | in_flight: in_flight, window: window, progress: progress}
    end
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
  # The worker has failed, and has not been replaced yet.
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
    do: {[{:error, describe_error(error, nil, context)}], %{state | in_flight: :queue.new()}}

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
