defmodule Situ.Cluster.InletComponent do
  @moduledoc false
  # Receives a stream of another part, on any node: the consumer side of a GenStage edge to that part's publisher. It
  # records its position in the stream; when the publisher is lost, it waits for the next publisher and continues from
  # that position. A direct stream continues with the messages made from then on: the inlet identifies them by their
  # times and numbers them itself.
  use Situ.Component,
    outputs: [out: :any],
    options: [
      agent: [type: :any, required: true],
      part: [type: :any, required: true],
      stream: [type: :string, required: true],
      direct: [type: :boolean, default: false],
      reader: [type: :string, default: ""]
    ]

  alias Situ.Cluster.{MessageBatch, Member}
  alias Situ.Error

  # Messages of about this total size are in flight at the same time, within the two limits for their number.
  @window_bytes 12 * 1024 * 1024
  @min_window 4
  @max_window 4_000

  @impl true
  def init(opts) do
    {:ok, Map.merge(Map.new(opts), %{last: 0, made: 0, time: nil, sub: nil})}
  end

  @impl true
  def handle_start(_context, state) do
    Member.follow_publisher(state.agent, state.part)
    {[], state}
  end

  @impl true
  def snapshot(state), do: {:ok, Map.take(state, [:last, :made, :time])}
  @impl true
  def restore(mark, state), do: {:ok, Map.merge(state, mark)}

  # Requests messages again as soon as half of the window is free.
  @impl true
  def handle_demand(_n, _context, %{sub: %{demand: demand, window: window} = sub} = state)
      when demand <= div(window, 2) do
    send(sub.pid, {:"$gen_producer", {self(), sub.ref}, {:ask, window - demand}})
    {[], %{state | sub: %{sub | demand: window}}}
  end

  def handle_demand(_n, _context, state), do: {[], state}

  @impl true
  def handle_info({:situ_cluster, :publisher, _part, pid}, _context, %{sub: %{pid: pid}} = state),
    do: {[], state}

  def handle_info({:situ_cluster, :publisher, part, pid}, _context, %{part: part} = state),
    do: {[], state |> cancel_subscription() |> subscribe_to(pid)}

  def handle_info({:"$gen_consumer", {_, ref}, {:cancel, reason}}, _context, state)
      when state.sub.ref == ref do
    case reason do
      {:shutdown, {:closed, time}} -> {[{:close, :out, time}], cancel_subscription(state)}
      _ -> {[], cancel_subscription(state)}
    end
  end

  # The batch arrives packed, as for the log.
  def handle_info({:"$gen_consumer", {_, ref} = from, {:situ_batch, first, body}}, context, state)
      when state.sub.ref == ref,
      do: handle_info({:"$gen_consumer", from, unpack_messages(body, first)}, context, state)

  def handle_info({:"$gen_consumer", {_, ref}, messages}, _context, %{direct: true} = state)
      when state.sub.ref == ref and is_list(messages) and messages != [] do
    state = record_delivery(state, messages)

    unseen = Enum.drop_while(messages, &(state.time != nil and &1.originating_time <= state.time))

    {unseen, {last, made, time}} =
      Enum.map_reduce(unseen, {state.last, state.made, state.time}, fn m, {last, made, _} ->
        {m, made} = clamp_creation_time(m, made)
        {%{m | sequence_id: last + 1}, {last + 1, made, m.originating_time}}
      end)

    state = %{state | last: last, made: made, time: time}
    {if(unseen == [], do: [], else: [{:out, unseen}]), state}
  end

  def handle_info({:"$gen_consumer", {_, ref}, messages}, _context, state)
      when state.sub.ref == ref and is_list(messages) and messages != [] do
    state = record_delivery(state, messages)

    case Enum.drop_while(messages, &(&1.sequence_id <= state.last)) do
      [] ->
        {[], state}

      [%{sequence_id: id} | _] when id > state.last + 1 ->
        raise trimmed_error(state, id)

      unseen ->
        {unseen, made} = Enum.map_reduce(unseen, state.made, &clamp_creation_time/2)
        {[{:out, unseen}], %{state | last: List.last(unseen).sequence_id, made: made}}
    end
  end

  def handle_info({:DOWN, ref, :process, _, _}, _context, state) when state.sub.ref == ref,
    do: {[], %{state | sub: nil}}

  def handle_info(_other, _context, state), do: {[], state}

  defp record_delivery(state, messages) do
    demand = state.sub.demand - length(messages)
    %{state | sub: %{state.sub | demand: demand, window: demand_window(messages)}}
  end

  defp unpack_messages(body, first),
    do: body |> MessageBatch.unpack_rows() |> MessageBatch.rows_to_messages(first)

  # The sequence ids of a stream have no gaps, so the log no longer contains the missing messages.
  defp trimmed_error(state, id) do
    Error.new(
      :log_trimmed,
      "#{id - state.last - 1} messages of #{state.stream} are missing in the log",
      why: "they were trimmed before this part had received them",
      fix:
        "give the deployment a longer retain:, or add snapshot/1 to the part's components for checkpoints"
    )
  end

  # After a restart, a deterministic part repeats its messages with new creation times, and this inlet may have seen
  # some of them. Creation times must not decrease.
  defp clamp_creation_time(%{creation_time: time} = message, made) when time >= made,
    do: {message, time}

  defp clamp_creation_time(message, made), do: {%{message | creation_time: made}, made}

  @impl true
  def terminate(_reason, state), do: cancel_subscription(state)

  defp subscribe_to(state, pid) do
    ref = Process.monitor(pid)
    opts = [stream: state.stream, from: state.last, part: state.part, reader: state.reader]
    opts = [{:batches, true}, {:time, state.time} | opts]
    send(pid, {:"$gen_producer", {self(), ref}, {:subscribe, nil, opts}})
    send(pid, {:"$gen_producer", {self(), ref}, {:ask, @min_window}})
    %{state | sub: %{pid: pid, ref: ref, demand: @min_window, window: @min_window}}
  end

  defp demand_window([%{data: data} | _]),
    do:
      div(@window_bytes, max(:erlang.external_size(data), 1))
      |> max(@min_window)
      |> min(@max_window)

  defp cancel_subscription(%{sub: nil} = state), do: state

  defp cancel_subscription(%{sub: sub} = state) do
    Process.demonitor(sub.ref, [:flush])
    send(sub.pid, {:"$gen_producer", {self(), sub.ref}, {:cancel, :normal}})
    %{state | sub: nil}
  end
end
