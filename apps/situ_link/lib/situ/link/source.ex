defmodule Situ.Link.Source do
  @moduledoc false
  # Emits a stream of a link as a source. Batches from the connection are queued as bytes until the pipeline asks for
  # messages. Only then are they decoded, and the sender is granted new credit.
  use Situ.Component,
    inputs: [],
    outputs: [out: :any],
    options: [
      link: [type: :pid, required: true, doc: "The `Situ.Link.Connection`."],
      request: [type: :map, required: true, doc: "The request: stream, start, policy, priority."],
      type: [type: :any, default: :any, doc: "The data type. Other messages are dropped."]
    ]

  alias Situ.{Error, Type}
  alias Situ.Link.Connection
  alias Situ.Link.Wire.{Batch, ClockEstimate}
  alias Situ.Store.Envelopes

  @before_all Batch.before_all()

  defstruct [
    :link,
    :request,
    :type,
    :id,
    :close_time,
    :problem,
    queue: :queue.new(),
    # `last` is a time of the sender's clock, `last_emitted` a time of the clock used for the emitted messages.
    last: @before_all,
    last_emitted: @before_all,
    envelope: nil,
    unreadable: 0,
    late: 0,
    emitted: 0,
    lost: 0,
    done?: false
  ]

  @impl true
  def init(opts) do
    {:ok,
     %__MODULE__{
       link: opts[:link],
       request: opts[:request],
       type: opts[:type],
       envelope: Envelopes.initial_envelope()
     }}
  end

  @impl true
  def handle_start(_context, state) do
    case Connection.subscribe(state.link, state.request) do
      {:ok, id} -> {[], %{state | id: id}}
      {:error, error} -> raise error
    end
  catch
    :exit, _ ->
      raise Error.new(:link_closed, "the link to #{state.request.name} is closed",
              fix: "open the link in the pipeline that uses it"
            )
  end

  @impl true
  def handle_info({:situ_link, id, event}, _context, %{id: id} = state),
    do: {[], handle_event(state, event)}

  def handle_info(_other, _context, state), do: {[], state}

  defp handle_event(state, {:batch, _, _, _} = batch),
    do: %{state | queue: :queue.in(batch, state.queue)}

  defp handle_event(state, {:closed, time}), do: %{state | close_time: time}
  defp handle_event(state, {:lost, n}), do: %{state | lost: state.lost + n}

  @impl true
  def handle_demand(_n, _context, %{done?: true} = state), do: {[], state}

  def handle_demand(n, context, state) do
    case :queue.out(state.queue) do
      {{:value, batch}, queue} ->
        state |> Map.put(:queue, queue) |> read_batch(batch) |> emit_messages(n, context)

      {:empty, _} when state.close_time != nil ->
        close_output(state)

      {:empty, _} ->
        {[], state}
    end
  end

  # If no message of a batch remains, the next batch is used.
  defp emit_messages({[], state}, n, context), do: handle_demand(n, context, state)
  defp emit_messages({messages, state}, _n, _context), do: {[{:out, messages}], state}

  defp close_output(state) do
    time = max(state.close_time, state.last_emitted)
    {[{:close, :out, time}], %{state | done?: true}}
  end

  defp read_batch(state, {:batch, size, payload, clock}) do
    case Batch.decode(payload) do
      {:ok, messages} ->
        {newer, late} = Enum.split_with(messages, &(&1.originating_time > state.last))
        state = %{state | late: state.late + length(late)}
        last = if newer == [], do: state.last, else: List.last(newer).originating_time
        Connection.report_consumed(state.link, state.id, size, last)

        newer
        |> drop_unordered(state)
        |> filter_by_type()
        |> convert_times(clock)
        |> forward_envelopes()

      {:error, why} ->
        Connection.report_consumed(state.link, state.id, size, nil)
        {[], %{state | unreadable: state.unreadable + 1, problem: why}}
    end
  end

  # Times within a batch increase, unless the sender is malicious.
  defp drop_unordered(messages, state) do
    {ordered, {last, out_of_order}} =
      Enum.flat_map_reduce(messages, {state.last, 0}, fn message, {last, n} ->
        if message.originating_time > last,
          do: {[message], {message.originating_time, n}},
          else: {[], {last, n + 1}}
      end)

    {ordered, %{state | last: last, late: state.late + out_of_order}}
  end

  defp filter_by_type({messages, %{type: :any} = state}), do: {messages, state}

  defp filter_by_type({messages, state}) do
    {valid, invalid} = Enum.split_with(messages, &Type.valid_value?(state.type, &1.data))

    problem =
      if invalid == [],
        do: state.problem,
        else: "data that do not match #{Type.to_string(state.type)}"

    {valid, %{state | unreadable: state.unreadable + length(invalid), problem: problem}}
  end

  # The clock estimate may move backwards slightly, but the times of a stream must not.
  defp convert_times({messages, state}, nil), do: {messages, record_emitted(state, messages)}

  defp convert_times({messages, state}, clock) do
    {messages, last} =
      Enum.map_reduce(messages, state.last_emitted, fn message, last ->
        time = max(ClockEstimate.to_local_time(clock, message.originating_time), last + 1)
        creation = max(ClockEstimate.to_local_time(clock, message.creation_time), time)
        {%{message | originating_time: time, creation_time: creation}, time}
      end)

    {messages, %{state | last_emitted: last}}
  end

  defp record_emitted(state, []), do: state

  defp record_emitted(state, messages),
    do: %{state | last_emitted: List.last(messages).originating_time}

  defp forward_envelopes({messages, state}) do
    {messages, envelope} = Envelopes.make_monotonic(messages, state.envelope)
    {messages, %{state | envelope: envelope, emitted: state.emitted + length(messages)}}
  end

  @impl true
  def handle_stop(_final, _context, state),
    do: {[], %{state | done?: true, queue: :queue.new()}}

  @impl true
  def terminate(_reason, %{id: nil}), do: :ok
  def terminate(_reason, state), do: Connection.unsubscribe(state.link, state.id)

  @impl true
  def describe(state) do
    problem = if state.problem, do: " (#{state.problem})", else: ""

    "#{state.emitted} messages, #{state.lost} left out by the sender, " <>
      "#{state.unreadable} unreadable#{problem}, #{state.late} not later than the previous one"
  end
end
