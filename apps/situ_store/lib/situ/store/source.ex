defmodule Situ.Store.Source do
  @moduledoc false
  # The component of `Situ.Store.stream/3`: emits one stored stream as a source.
  #
  # Messages are emitted on demand with their recorded envelopes, from the start of the replay to
  # its end. With an enforced clock, the pipeline delivers each message at its originating time. A
  # store that is being written is followed until its writer is done. `Situ.Store.Importer.seek/2`
  # moves the position.
  use Situ.Component,
    inputs: [],
    outputs: [out: :any],
    options: [
      importer: [type: :any, required: true],
      info: [type: :any, required: true],
      type: [type: :any, default: nil],
      live: [type: :boolean, default: false],
      to: [type: :any, default: :unbounded]
    ]

  alias Situ.{Clock, Columns, Pipeline, Recording}
  alias Situ.Columns.Validation
  alias Situ.Store.{Envelopes, SchemaEvolution, Playhead, Query}

  defstruct [
    :importer,
    :info,
    :upgrade,
    :from,
    :to,
    :last,
    live: false,
    ordinal: 0,
    # Messages (or columns) that were read but not requested yet, and their number.
    buffer: {[], 0},
    # Whether numbers may be read as columns.
    columns?: false,
    shift: 0,
    known: 0,
    envelope: {0, -0x7FFFFFFFFFFFFFFF},
    sent: {0, -0x7FFFFFFFFFFFFFFF},
    version: 0,
    # :replaying, :listening (a player at its end, until the clock jumps), :done
    phase: :replaying
  ]

  @tag 1
  # So many bytes of the file are read together as columns.
  @bytes 64 * 1024

  @impl true
  def init(opts) do
    info = opts[:info]

    state = %__MODULE__{
      importer: opts[:importer],
      info: info,
      upgrade: SchemaEvolution.build_upgrade!(info, opts[:type]),
      live: opts[:live],
      to: opts[:to],
      columns?: opts[:type] == nil and Recording.implements?(opts[:importer].store, :columns, 5)
    }

    {:ok, state}
  end

  @impl true
  def handle_start(context, state) do
    # If the requested end is before the first message, the replay ends at its start.
    replay_end = if context.replay_end == :infinity, do: :unbounded, else: context.replay_end
    replay_end = min_time(replay_end, if(state.to != :unbounded, do: state.to))
    from = if state.live, do: nil, else: context.start_time
    to = if state.importer.period, do: replay_end, else: min_time(replay_end, state.info.closed)
    {:ok, ordinal} = if from, do: seek_ordinal(state, from), else: {:ok, 0}

    # While a store is being written, its end is determined by the writer. A loop ends only with the replay, and a
    # player waits at its end instead of ending.
    %{period: period, keep_open: keep_open?} = state.importer
    endless? = keep_open? or (period != nil and replay_end == :unbounded)
    actions = if endless?, do: [{:complete, :infinity}], else: []
    {actions, %{state | from: from, to: to, ordinal: ordinal, last: from || context.start_time}}
  end

  defp min_time(:unbounded, nil), do: :unbounded
  defp min_time(:unbounded, closed), do: closed
  defp min_time(to, nil), do: to
  defp min_time(to, closed), do: min(to, closed)

  defp seek_ordinal(%{info: %{id: -1}}, _time), do: {:ok, 0}

  defp seek_ordinal(state, time), do: Query.seek_ordinal(state.importer.store, state.info, time)

  @impl true
  def handle_demand(_n, _context, %{phase: :done} = state), do: {[], state}

  def handle_demand(n, context, state) do
    state = follow_seek(state)

    {actions, next} =
      case state.buffer do
        {[], 0} -> load_batch(n, context, state)
        _ -> emit_buffered(n, state)
      end

    if Playhead.claim_time(state.importer.head, next.last, state.version),
      do: {actions, next},
      else: handle_demand(n, context, state)
  end

  # Applies a seek of the importer. Within the epoch it only skips messages; a new epoch may start anywhere.
  defp follow_seek(%{importer: %{head: head}, version: version} = state) do
    if Playhead.seek_version(head) == version,
      do: state,
      else: apply_seek(state, Playhead.read_view(head))
  end

  defp apply_seek(state, {version, time, shift}) do
    {:ok, ordinal} = seek_ordinal(state, max_time(time, state.from))
    state = %{state | version: version}

    cond do
      shift != state.shift ->
        {sequence, creation} = state.sent
        envelope = {sequence, creation - shift}
        %{state | shift: shift, ordinal: ordinal, buffer: {[], 0}, envelope: envelope}

      ordinal > state.ordinal - elem(state.buffer, 1) ->
        %{state | ordinal: ordinal, buffer: {[], 0}}

      true ->
        state
    end
  end

  defp max_time(time, nil), do: time
  defp max_time(time, from), do: max(time, from)

  defp emit_buffered(n, %{buffer: {%Columns{} = columns, count}} = state) when n >= count,
    do: emit_columns(columns, %{state | buffer: {[], 0}})

  defp emit_buffered(n, %{buffer: {%Columns{} = columns, count}} = state) do
    later = {Columns.slice(columns, n, count - n), count - n}
    emit_columns(Columns.slice(columns, 0, n), %{state | buffer: later})
  end

  defp emit_buffered(n, %{buffer: {messages, count}} = state) when n >= count,
    do: emit_messages(shift_times(messages, state.shift), %{state | buffer: {[], 0}})

  defp emit_buffered(n, %{buffer: {messages, count}} = state) do
    {now, later} = Enum.split(messages, n)
    emit_messages(shift_times(now, state.shift), %{state | buffer: {later, count - n}})
  end

  defp emit_messages([], state), do: {[], state}

  defp emit_messages(messages, state) do
    last = List.last(messages)
    envelope = {last.sequence_id, last.creation_time}
    {[{:out, messages}], %{state | last: last.originating_time, sent: envelope}}
  end

  defp emit_columns(columns, state) do
    {time, creation, id} = Columns.last_stamp(columns)
    {[{:out, columns}], %{state | last: time, sent: {id, creation}}}
  end

  defp shift_times(messages, 0), do: messages

  defp shift_times(messages, shift) do
    for message <- messages do
      %{
        message
        | originating_time: message.originating_time + shift,
          creation_time: message.creation_time + shift
      }
    end
  end

  defp load_batch(n, context, %{info: %{id: -1}} = state), do: handle_end(n, context, state)

  # The enforced clock takes messages one by one.
  defp load_batch(n, %{enforced?: false} = context, %{columns?: true, shift: 0} = state) do
    %{importer: %{store: store}, envelope: {last_id, last_creation}} = state

    case store.module.columns(store.state, state.info, state.ordinal, read_limit(state), @bytes) do
      {:ok, columns, next} ->
        # Other envelopes are changed by `Envelopes.make_monotonic/2`.
        if Validation.continues?(columns, last_id, last_creation) do
          {_time, creation, id} = Columns.last_stamp(columns)
          buffer = {columns, columns.count}
          emit_buffered(n, %{state | envelope: {id, creation}, ordinal: next, buffer: buffer})
        else
          load_batch(n, context, %{state | columns?: false})
        end

      :ended ->
        load_messages(n, context, state)

      # Reading messages reports damage.
      _others ->
        load_batch(n, context, %{state | columns?: false})
    end
  end

  defp load_batch(n, context, state), do: load_messages(n, context, state)

  defp load_messages(n, context, state) do
    %{store: store, skip_damage: skip?} = state.importer

    case Query.read_batch(store, state.info, state.ordinal, read_limit(state), 512,
           skip_damage: skip?
         ) do
      {:ok, [], _} ->
        handle_end(n, context, state)

      {:ok, messages, next} ->
        {messages, envelope} =
          messages |> state.upgrade.() |> Envelopes.make_monotonic(state.envelope)

        state = %{state | envelope: envelope, ordinal: next}
        emit_buffered(n, %{state | buffer: {messages, length(messages)}})

      {:error, error} ->
        raise error
    end
  end

  defp handle_end(_n, _context, %{live: true} = state), do: await_writer(state)

  defp handle_end(n, context, %{importer: %{period: period}, info: %{count: count}} = state)
       when period != nil and count > 0 do
    {:ok, ordinal} = seek_ordinal(state, state.from)
    {sequence, creation} = state.envelope
    envelope = {sequence, creation - period}
    again = %{state | ordinal: ordinal, shift: state.shift + period, envelope: envelope}
    over? = is_integer(read_limit(again)) and read_limit(again) < state.info.first

    if ordinal < count and not over?, do: load_batch(n, context, again), else: close_output(state)
  end

  # A player at its end detects a seek by the clock's jump.
  defp handle_end(_n, context, %{importer: %{keep_open: true}} = state) do
    if state.phase != :listening, do: Clock.subscribe(Pipeline.clock(context.pipeline))
    {[], %{state | phase: :listening}}
  end

  defp handle_end(_n, _context, state), do: close_output(state)

  defp close_output(state), do: {[{:close, :out, state.last}], %{state | phase: :done}}

  # Returns the replay's end in recorded time. A loop continues until the pipeline's end time.
  defp read_limit(%{to: to, importer: %{period: period}} = state)
       when is_integer(to) and period != nil,
       do: to - state.shift

  defp read_limit(%{to: to}), do: to

  # There are no more messages for now, so wait for a notification of the writer.
  defp await_writer(state) do
    Query.notify(state.importer.store, state.known, @tag)
    {[], state}
  end

  @impl true
  def handle_info({:situ_store, @tag, {:published, n}}, _context, state),
    do: {[], %{state | known: n}}

  def handle_info({:situ_store, @tag, {:ended, n}}, _context, state) do
    # The writer is gone. Its last catalog records, which may include the close, decide where the stream ends.
    info = Enum.find(Query.streams(state.importer.store), state.info, &(&1.id == state.info.id))

    {[], %{state | known: n, live: false, to: min_time(state.to, info.closed)}}
  end

  def handle_info(_, _context, state), do: {[], state}

  @impl true
  def handle_stop(_final, _context, state), do: {[], %{state | phase: :done, buffer: {[], 0}}}

  @impl true
  def describe(state), do: "replays #{state.info.name} from #{state.importer.store.path}"
end
