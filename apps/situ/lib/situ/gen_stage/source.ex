defmodule Situ.GenStage.Source do
  @moduledoc false
  # The consumer side of the protocol: requests `max_demand` events from each producer, and more once the pipeline has
  # consumed part of them.
  use Situ.Component,
    outputs: [out: :any],
    options: [
      producers: [type: {:or, [{:list, :any}, {:fun, 0}]}, default: []],
      subscribe: [type: :keyword, default: []]
    ]

  alias Situ.{Error, Message}

  @max_demand 1_000

  @impl true
  def init(opts) do
    with {:ok, _, _} <- validate_demand(opts[:subscribe]),
         do: {:ok, %{opts: opts, subs: %{}, last: nil, ended: false}}
  end

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    producers = list_producers(opts[:producers])
    state = Enum.reduce(producers, state, &start_subscription(&2, &1, opts[:subscribe]))
    {if(opts[:producers] == [], do: [{:complete, :infinity}], else: []), state}
  end

  defp list_producers(producers) when is_list(producers), do: producers
  defp list_producers(start), do: List.wrap(start.())

  defp start_subscription(state, producer, opts) do
    case subscribe_producer(state, producer, opts) do
      {:ok, _ref, state} -> state
      {:error, error} -> raise error
    end
  end

  # Demand means that the pipeline has room. Requests as many events as were consumed, once there are at least `max -
  # min`.
  @impl true
  def handle_demand(_n, _context, state) do
    {[], %{state | subs: Map.new(state.subs, fn {ref, sub} -> {ref, request_more(ref, sub)} end)}}
  end

  defp request_more(ref, %{taken: taken, max: max, min: min} = sub)
       when taken > 0 and taken >= max - min do
    send(sub.pid, {:"$gen_producer", {self(), ref}, {:ask, taken}})
    %{sub | taken: 0}
  end

  defp request_more(_ref, sub), do: sub

  @impl true
  def handle_info({:"$gen_consumer", {_pid, ref}, {:cancel, reason}}, context, state)
      when is_map_key(state.subs, ref),
      do: remove_subscription(ref, reason, context, state)

  def handle_info({:"$gen_consumer", {_pid, ref}, events}, context, state)
      when is_map_key(state.subs, ref) and is_list(events) do
    n = length(events)
    state = update_in(state.subs[ref].taken, &(&1 + n))

    # The last event is stamped with the current time, unless the earlier events leave too little room before it.
    first =
      max(context.now - n + 1, if(state.last, do: state.last + 1, else: context.now - n + 1))

    {actions, last} = Enum.map_reduce(events, {first, state.last}, &event_action/2)
    {actions, %{state | last: elem(last, 1)}}
  end

  def handle_info({:DOWN, ref, :process, _pid, reason}, context, state)
      when is_map_key(state.subs, ref),
      do: remove_subscription(ref, reason, context, state)

  # A producer's failure and end arrive as separate messages, because skipping an error undoes only the effects of the
  # message that raised it.
  def handle_info({:situ_producer_failed, error}, _context, _state), do: raise(error)

  def handle_info(:situ_producer_ended, context, %{subs: subs, ended: false} = state)
      when subs == %{} do
    if state.opts[:producers] == [],
      do: {[], state},
      else: {[{:complete, state.last || context.now}], %{state | ended: true}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_request({:"$subscribe", _current, to, opts}, from, _context, state) do
    case if(state.ended,
           do: {:error, not_running_error()},
           else: subscribe_producer(state, to, opts)
         ) do
      {:ok, ref, state} -> send_reply(from, {:ok, ref}, state)
      {:error, error} -> send_reply(from, {:error, error}, state)
    end
  end

  def handle_request(request, from, _context, state) do
    what =
      "a GenStage source does not support the request #{inspect(request, limit: 8, printable_limit: 80)}"

    send_reply(from, {:error, Error.new(:unknown_request, what)}, state)
  end

  defp send_reply(nil, _answer, state), do: {[], state}

  defp send_reply(from, answer, state) do
    GenServer.reply(from, answer)
    {[], state}
  end

  @impl true
  def handle_stop(_final, _context, state), do: {[], cancel_subscriptions(state)}

  @impl true
  def terminate(_reason, state), do: cancel_subscriptions(state)

  defp subscribe_producer(state, producer, opts) do
    with {:ok, max, min} <- validate_demand(opts), {:ok, pid} <- resolve_producer(producer) do
      ref = Process.monitor(pid)
      opts = Keyword.merge(opts, max_demand: max, min_demand: min)
      send(pid, {:"$gen_producer", {self(), ref}, {:subscribe, nil, opts}})
      send(pid, {:"$gen_producer", {self(), ref}, {:ask, max}})
      cancel = Keyword.get(opts, :cancel, :permanent)
      sub = %{pid: pid, taken: 0, max: max, min: min, cancel: cancel}
      {:ok, ref, put_in(state.subs[ref], sub)}
    end
  end

  defp validate_demand(opts) do
    max = is_list(opts) && Keyword.keyword?(opts) && Keyword.get(opts, :max_demand, @max_demand)
    min = is_integer(max) && Keyword.get(opts, :min_demand, div(max, 2))

    if is_integer(min) and max > 0 and min >= 0 and min < max,
      do: {:ok, max, min},
      else: {:error, bad_subscription_error(opts)}
  end

  defp bad_subscription_error(opts) do
    Error.new(:bad_subscription, "cannot subscribe with #{inspect(opts, limit: 8)}",
      why: "the options must be a keyword list with 0 <= min_demand < max_demand"
    )
  end

  defp resolve_producer(producer) do
    case GenServer.whereis(producer) do
      nil -> {:error, no_producer_error(producer)}
      pid -> {:ok, pid}
    end
  rescue
    # The term is not a valid process name.
    FunctionClauseError -> {:error, no_producer_error(producer)}
  end

  defp no_producer_error(producer),
    do: Error.new(:no_producer, "cannot subscribe to #{inspect(producer)}: process not found")

  defp not_running_error,
    do: Error.new(:not_running, "the stream has ended", why: "its producers ended")

  defp cancel_subscriptions(state) do
    for {ref, sub} <- state.subs do
      send(sub.pid, {:"$gen_producer", {self(), ref}, {:cancel, :normal}})
      Process.demonitor(ref, [:flush])
    end

    %{state | subs: %{}, ended: true}
  end

  defp remove_subscription(ref, reason, _context, state) do
    Process.demonitor(ref, [:flush])
    {sub, subs} = Map.pop(state.subs, ref)

    if not orderly_exit?(reason) and sub.cancel != :temporary,
      do: send(self(), {:situ_producer_failed, producer_failed_error(sub.pid, reason)})

    send(self(), :situ_producer_ended)
    {[], %{state | subs: subs}}
  end

  defp orderly_exit?(reason), do: reason in [:normal, :shutdown] or match?({:shutdown, _}, reason)

  defp producer_failed_error(pid, reason) do
    Error.new(
      :producer_failed,
      "the GenStage producer #{inspect(pid)} failed: #{format_reason(reason)}",
      why: "it canceled the subscription or exited with this reason",
      fix: "see the producer's log; a partition dispatcher needs subscribe: [partition: ...]",
      meta: %{reason: reason}
    )
  end

  defp format_reason(%{__exception__: true} = error), do: Exception.message(error)
  defp format_reason(reason), do: Exception.format_exit(reason)

  defp event_action(%Message{originating_time: time} = message, {next, _last}),
    do: {{:out, time, message.data}, {max(next, time + 1), time}}

  defp event_action(data, {next, _last}), do: {{:out, next, data}, {next + 1, next}}
end
