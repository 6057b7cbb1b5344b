defmodule Situ.Store.Sink do
  @moduledoc false
  # The component of `Situ.Store.write/4`: collects messages of one stream of a pipeline and commits
  # them together. Committed messages survive a kill of the process.
  #
  # Numbers and short binaries wait in a `Situ.Store.StreamDraft`. From the first message on that
  # does not fit there, messages wait in this process instead, so that all stay in order. Segmented
  # recordings and eager ones have no draft.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [],
    options: [
      shared: [type: :any, default: nil, doc: "The `Situ.Store.SharedWriter`."],
      stream: [type: :any, default: nil, doc: "The `Situ.Store.Writer.Stream`."],
      envelopes: [type: :boolean, default: false, doc: "Write only the envelopes."],
      eager: [type: :boolean, default: false, doc: "Commit every delivery immediately."],
      pass: [type: :boolean, default: false, doc: "Emit the messages that are committed."],
      rotation: [
        type: :any,
        default: nil,
        doc: "`{rotation, cut, name, options}` of a segmented recording (`Situ.Store.Rotation`)."
      ]
    ]

  alias Situ.{Columns, Error, VideoPacket}
  alias Situ.Store.{Rotation, SharedWriter, SinkSnapshot, StreamDraft, Writer}
  alias Situ.Store.Rotation.SplitPoint

  @flush_ms 20
  @most 512
  @bytes 64 * 1024

  # A commit costs about 25 us of CPU, mostly for the change of threads.
  @most_in_draft 4_096
  @draft_bytes 256 * 1024

  defstruct [
    :shared,
    :stream,
    :draft,
    :envelopes,
    :eager,
    :rotation,
    :segment,
    :pass,
    :span,
    :closed,
    held: %{},
    pending: [],
    count: 0,
    bytes: 0,
    plain: true,
    fresh: true,
    timer: nil
  ]

  @impl true
  def init(opts) do
    {:ok,
     %__MODULE__{
       shared: opts[:shared],
       stream: opts[:stream],
       draft: new_draft(opts),
       envelopes: opts[:envelopes],
       eager: opts[:eager],
       rotation: opts[:rotation],
       pass: opts[:pass]
     }}
  end

  defp new_draft(opts),
    do: if(opts[:stream] && not opts[:eager], do: StreamDraft.new(opts[:stream]))

  @impl true
  def handle_message(:in, message, context, state),
    do: handle_messages(:in, [message], context, state)

  # Every delivery is committed immediately, so all messages before these are committed too.
  @impl true
  def handle_messages(:in, messages, _context, %{pass: true} = state) do
    {[], state} = write_messages(messages, state)
    {[{:out, messages}], state}
  end

  def handle_messages(:in, messages, _context, state), do: write_messages(messages, state)

  # Numbers go to the draft as they are. The other ways of writing take messages.
  @impl true
  def handle_columns(:in, columns, context, state) do
    case add_columns(columns, state) do
      :refused ->
        handle_messages(:in, Columns.messages(columns), context, state)

      size ->
        commit_large_draft(size, %{state | span: SinkSnapshot.extend_span(state.span, columns)})
    end
  end

  defp add_columns(_columns, %{draft: nil}), do: :refused
  defp add_columns(_columns, %{envelopes: true}), do: :refused
  defp add_columns(columns, %{draft: draft}), do: StreamDraft.add_columns(draft, columns)

  defp write_messages(messages, %{rotation: {_, cut, _, _}} = state) do
    messages
    |> Enum.map_reduce(state.segment, fn message, previous ->
      number = segment_number(message, cut, previous)
      {{number, message}, number}
    end)
    |> elem(0)
    |> Enum.chunk_by(&elem(&1, 0))
    |> Enum.reduce({[], state}, fn [{number, _} | _] = part, {[], state} ->
      part = Enum.map(part, &elem(&1, 1))

      buffer_messages(
        part,
        if(number == state.segment, do: state, else: enter_segment(flush_pending(state), number))
      )
    end)
  end

  defp write_messages(messages, state),
    do: buffer_messages(messages, %{state | span: SinkSnapshot.extend_span(state.span, messages)})

  # A segment of a video begins with a key frame, so the images before it stay in the segment of theirs.
  defp segment_number(%{data: %VideoPacket{position: position}}, _cut, previous)
       when position > 0 and previous != nil,
       do: previous

  defp segment_number(message, cut, _previous),
    do: SplitPoint.segment_number(cut, message.originating_time)

  # Selects the segment for these times, or the oldest open segment if the other streams are far ahead.
  defp enter_segment(%{rotation: {rotation, _cut, name, opts}} = state, number) do
    case Rotation.open_stream(rotation, number, name, opts) do
      {:ok, real, stream} ->
        # Late messages make the stream return to a previous segment, so keep the codecs and fields noted for it.
        stream = Map.get(state.held, real, stream)
        held = state.held |> Map.filter(fn {n, _} -> n >= real end) |> Map.put(real, stream)
        %{state | segment: number, stream: stream, held: held}

      {:error, error} ->
        raise error
    end
  end

  defp buffer_messages(messages, %{envelopes: true} = state),
    do: messages |> Enum.map(&%{&1 | data: nil}) |> collect_messages(state)

  defp buffer_messages(messages, state), do: collect_messages(messages, state)

  defp collect_messages(messages, %{draft: nil} = state) do
    {count, bytes, plain} = measure_messages(messages, state.count, state.bytes, state.plain)
    pending = [messages | state.pending]
    state = %{state | pending: pending, count: count, bytes: bytes, plain: plain}

    if state.eager or count >= @most or bytes >= @bytes,
      do: {[], flush_pending(state)},
      else: {[], start_timer(state, @flush_ms)}
  end

  defp collect_messages(messages, %{draft: draft} = state) do
    case StreamDraft.add(draft, messages) do
      :refused ->
        unwrap!(commit_draft(state))
        collect_messages(messages, %{state | draft: nil})

      size ->
        commit_large_draft(size, state)
    end
  end

  defp commit_large_draft({count, bytes}, state)
       when count >= @most_in_draft or bytes >= @draft_bytes do
    unwrap!(StreamDraft.commit(state.draft))
    {[], state}
  end

  defp commit_large_draft(_size, state), do: {[], start_timer(state, @flush_ms)}

  defp start_timer(%{timer: nil} = state, ms),
    do: %{state | timer: Process.send_after(self(), :flush, ms)}

  defp start_timer(state, _ms), do: state

  # Images and audio count with their payload size, so that they do not accumulate here. A struct may have a codec.
  defp measure_messages([%{data: data} | rest], count, bytes, plain) when is_number(data),
    do: measure_messages(rest, count + 1, bytes + 8, plain)

  defp measure_messages([%{data: data} | rest], count, bytes, plain) when is_binary(data),
    do: measure_messages(rest, count + 1, bytes + byte_size(data), plain)

  defp measure_messages([%{data: %_{data: data}} | rest], count, bytes, _plain)
       when is_binary(data),
       do: measure_messages(rest, count + 1, bytes + byte_size(data), false)

  defp measure_messages([%{data: data} | rest], count, bytes, plain),
    do: measure_messages(rest, count + 1, bytes + 64, plain and not is_struct(data))

  defp measure_messages([], count, bytes, plain), do: {count, bytes, plain}

  @impl true
  def handle_info(:flush, _context, %{draft: nil} = state),
    do: {[], flush_pending(%{state | timer: nil})}

  def handle_info(:flush, _context, state), do: {[], flush_draft(%{state | timer: nil})}
  def handle_info(_, _context, state), do: {[], state}

  # Another stream may have committed the messages, and others may have arrived since.
  defp flush_draft(%{draft: draft} = state) do
    case StreamDraft.waiting_ms(draft) do
      nil ->
        state

      ms when ms < @flush_ms ->
        start_timer(state, @flush_ms - ms)

      _ ->
        unwrap!(StreamDraft.commit_all(draft))
        state
    end
  end

  @impl true
  def handle_closed(:in, time, _context, state) do
    unwrap!(commit_draft(state))
    state = flush_pending(state)

    # In a segmented recording, only the last segment's stream is closed. It is nil if there were no messages.
    if state.stream, do: unwrap!(Writer.close_stream(state.stream, time))
    {[], %{state | closed: time}}
  end

  # The open segments and their numbers are not in the snapshot.
  @impl true
  def snapshot(%{rotation: {_, _, name, _}}) do
    {:error,
     Error.new(:no_snapshot, "cannot take a snapshot of #{name}: it is recorded in segments",
       why: "a recording in segments cannot continue on another node",
       fix: "record it without segments, or in a part that is not placed"
     )}
  end

  def snapshot(state) do
    pending = state.pending |> Enum.reverse() |> Enum.concat()

    with :ok <- commit_draft(state),
         do:
           {:ok, SinkSnapshot.new(state.shared, state.stream, state.span, pending, state.closed)}
  end

  @impl true
  def restore(snapshot, state) do
    with {:ok, stream, span} <- SinkSnapshot.restore(snapshot, state.stream) do
      if snapshot.closed, do: unwrap!(Writer.close_stream(stream, snapshot.closed))
      {:ok, %{state | stream: stream, span: span, closed: snapshot.closed}}
    end
  end

  @impl true
  def terminate(_reason, state) do
    # After an error, earlier deliveries are still worth keeping. A second error would hide the first one.
    _ = commit_draft(state)
    _ = if state.pending != [], do: append_pending(state)
    if state.shared, do: SharedWriter.remove_user(state.shared), else: :ok
  end

  @impl true
  def describe(%{rotation: {_, _, name, _}}), do: "writes #{name} in segments"
  def describe(state), do: "writes #{state.stream.name} to #{state.shared.writer.path}"

  defp commit_draft(%{draft: nil}), do: :ok

  # Many streams often close together, and the first one commits the messages of all.
  defp commit_draft(%{draft: draft}),
    do: if(StreamDraft.waiting_ms(draft), do: StreamDraft.commit_all(draft), else: :ok)

  defp flush_pending(%{pending: []} = state), do: state

  defp flush_pending(state) do
    {state, stream} = finish_append(state, append_pending(state))
    _ = state.timer && Process.cancel_timer(state.timer)
    %{state | stream: stream, pending: [], count: 0, bytes: 0, plain: true, timer: nil}
  end

  # If the segment was closed in the meantime, pending messages go into the oldest open segment.
  defp finish_append(%{rotation: {_, _, _, _}} = state, {:error, %{code: :closed}}) do
    state = enter_segment(%{state | held: %{}}, state.segment)
    put_stream(state, unwrap!(append_pending(state)))
  end

  # The process before this one may have committed some of these messages before it died. They can arrive in several
  # deliveries, so it is only the first later message that is certainly new.
  defp finish_append(%{fresh: true} = state, {:error, %{code: :not_increasing} = error}) do
    later? = &(&1.originating_time > error.meta.last)
    batches = for batch <- state.pending, do: Enum.filter(batch, later?)

    case Enum.reject(batches, &(&1 == [])) do
      [] ->
        {state, state.stream}

      later ->
        state = %{state | fresh: false, pending: later}
        put_stream(state, unwrap!(append_pending(state)))
    end
  end

  defp finish_append(state, result), do: put_stream(%{state | fresh: false}, unwrap!(result))

  defp put_stream(%{rotation: nil} = state, stream), do: {state, stream}

  defp put_stream(%{rotation: {rotation, cut, _, _}} = state, stream) do
    Rotation.report_append(rotation, cut, state.segment, latest_time(state.pending))

    held =
      Map.new(state.held, fn {n, s} -> {n, if(s.writer == stream.writer, do: stream, else: s)} end)

    {%{state | held: held}, stream}
  end

  # Batches are sorted newest first.
  defp latest_time([batch | _]), do: List.last(batch).originating_time

  defp append_pending(%{plain: true} = state),
    do: Writer.append_plain(state.stream, Enum.reverse(state.pending))

  defp append_pending(state),
    do: Writer.append(state.stream, state.pending |> Enum.reverse() |> Enum.concat())

  defp unwrap!(:ok), do: :ok
  defp unwrap!({:ok, value}), do: value
  defp unwrap!({:error, error}), do: raise(error)
end
