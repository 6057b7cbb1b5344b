defmodule Situ.Link.Source do
  @moduledoc false
  # Emits a stream of a link as a source. Batches from the connection are queued as bytes until the pipeline asks for
  # messages. Only then are they decoded, and the sender is granted new credit.
  use Situ.Component,
    inputs: [],
    outputs: [out: :any],
    options: [
      link: [type: :pid, required: true, doc: "The `Situ.Link.Connection`."],
      wanted: [type: :map, required: true, doc: "The request: stream, start, policy, priority."],
      type: [type: :any, default: :any, doc: "The data type. Other messages are dropped."]
    ]

  alias Situ.{Error, Type}
  alias Situ.Link.Connection
  alias Situ.Link.Wire.{Batch, ClockEstimate}
  alias Situ.Store.Envelopes

  # This time is earlier than the times of all messages.
  @before_all -0x4000000000000000

  defstruct [
    :link,
    :wanted,
    :type,
    :id,
    :closed,
    :trouble,
    queue: :queue.new(),
    # `last` is a time of the sender's clock, `posted` a time of the clock used for the emitted messages.
    last: @before_all,
    posted: @before_all,
    envelope: nil,
    unreadable: 0,
    late: 0,
    taken: 0,
    lost: 0,
    done: false
  ]

  @impl true
  def init(opts) do
    {:ok,
     %__MODULE__{
       link: opts[:link],
       wanted: opts[:wanted],
       type: opts[:type],
       envelope: Envelopes.initial_envelope()
     }}
  end

  @impl true
  def handle_start(_context, state) do
    case Connection.subscribe(state.link, state.wanted) do
      {:ok, id} -> {[], %{state | id: id}}
      {:error, error} -> raise error
    end
  catch
    :exit, _ ->
      raise Error.new(:link_closed, "the link to #{state.wanted.name} is closed",
              fix: "open the link in the pipeline that uses it"
            )
  end

  @impl true
  def handle_info({:situ_link, id, event}, _context, %{id: id} = state),
    do: {[], handle_event(state, event)}

  def handle_info(_other, _context, state), do: {[], state}

  defp handle_event(state, {:batch, _, _, _} = batch),
    do: %{state | queue: :queue.in(batch, state.queue)}

  defp handle_event(state, {:closed, time}), do: %{state | closed: time}
  defp handle_event(state, {:lost, n}), do: %{state | lost: state.lost + n}

  @impl true
  def handle_demand(_n, _context, %{done: true} = state), do: {[], state}

  def handle_demand(n, context, state) do
    case :queue.out(state.queue) do
      {{:value, batch}, queue} ->
        state |> Map.put(:queue, queue) |> read_batch(batch) |> emit_messages(n, context)

      {:empty, _} when state.closed != nil ->
        close_output(state)

      {:empty, _} ->
        {[], state}
    end
  end

  # If no message of a batch remains, the next batch is used.
  defp emit_messages({[], state}, n, context), do: handle_demand(n, context, state)
  defp emit_messages({messages, state}, _n, _context), do: {[{:out, messages}], state}

  defp close_output(state) do
    time = max(state.closed, state.posted)
    {[{:close, :out, time}], %{state | done: true}}
  end

  defp read_batch(state, {:batch, size, payload, clock}) do
    case Batch.decode(payload) do
      {:ok, messages} ->
        {fresh, late} = Enum.split_with(messages, &(&1.originating_time > state.last))
        state = %{state | late: state.late + length(late)}
        last = if fresh == [], do: state.last, else: List.last(fresh).originating_time
        Connection.report_consumed(state.link, state.id, size, last)

        fresh
        |> drop_unordered(state)
        |> filter_by_type()
        |> convert_times(clock)
        |> forward_envelopes()

      {:error, why} ->
        Connection.report_consumed(state.link, state.id, size, nil)
        {[], %{state | unreadable: state.unreadable + 1, trouble: why}}
    end
  end

  # Times within a batch increase, unless the sender is malicious.
  defp drop_unordered(messages, state) do
    {kept, {last, out_of_order}} =
      Enum.flat_map_reduce(messages, {state.last, 0}, fn message, {last, n} ->
        if message.originating_time > last,
          do: {[message], {message.originating_time, n}},
          else: {[], {last, n + 1}}
      end)

    {kept, %{state | last: last, late: state.late + out_of_order}}
  end

  defp filter_by_type({messages, %{type: :any} = state}), do: {messages, state}

  defp filter_by_type({messages, state}) do
    {good, bad} = Enum.split_with(messages, &Type.valid_value?(state.type, &1.data))

    trouble =
      if bad == [],
        do: state.trouble,
        else: "data that do not match #{Type.to_string(state.type)}"

    {good, %{state | unreadable: state.unreadable + length(bad), trouble: trouble}}
  end

  # The clock estimate may move backwards slightly, but the times of a stream must not.
  defp convert_times({messages, state}, nil), do: {messages, record_posted(state, messages)}

  defp convert_times({messages, state}, clock) do
    {messages, last} =
      Enum.map_reduce(messages, state.posted, fn message, last ->
        time = max(ClockEstimate.to_local_time(clock, message.originating_time), last + 1)
        creation = max(ClockEstimate.to_local_time(clock, message.creation_time), time)
        {%{message | originating_time: time, creation_time: creation}, time}
      end)

    {messages, %{state | posted: last}}
  end

  defp record_posted(state, []), do: state
  defp record_posted(state, messages), do: %{state | posted: List.last(messages).originating_time}

  defp forward_envelopes({messages, state}) do
    {messages, envelope} = Envelopes.make_monotonic(messages, state.envelope)
    {messages, %{state | envelope: envelope, taken: state.taken + length(messages)}}
  end

  @impl true
  def handle_stop(_final, _context, state),
    do: {[], %{state | done: true, queue: :queue.new()}}

  @impl true
  def terminate(_reason, %{id: nil}), do: :ok
  def terminate(_reason, state), do: Connection.unsubscribe(state.link, state.id)

  @impl true
  def describe(state) do
    trouble = if state.trouble, do: " (#{state.trouble})", else: ""

    "#{state.taken} messages, #{state.lost} left out by the sender, " <>
      "#{state.unreadable} unreadable#{trouble}, #{state.late} not later than the previous one"
  end
end
