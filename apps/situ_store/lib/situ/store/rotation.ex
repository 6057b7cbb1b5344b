defmodule Situ.Store.Rotation do
  @moduledoc false
  # Splits a long recording into segments. Each segment is a store (the next version of the recording's name) for a span
  # of originating time, split by time or by size (`Situ.Store.Rotation.SplitPoint`). One process provides the
  # segments to the components that write, and ends with the pipeline. Every segment is a complete store, so a kill or
  # a power failure has the same effect as on any other store.
  #
  # Streams do not advance in lockstep, so the segment before the newest stays open for slower streams. Messages for
  # older segments go into the oldest open one. When `keep:` is exceeded, the oldest segments are deleted. These are
  # segments of this run and of earlier runs of the recorder (`Situ.Store.Rotation.EarlierRuns`), but never other
  # recordings of that name.
  # See docs/adr/0132-long-recordings-are-split-into-segments.md.
  use GenServer
  alias Situ.Store.{Draft, Folder, Maintenance, OpenRecordings, Writer}
  alias Situ.Store.Rotation.{SplitPoint, EarlierRuns, Retention}
  require Logger

  @type keep :: nil | {:span, Situ.Time.duration()} | {:bytes, pos_integer()}

  # `run`: distinguishes the segments of this run in their catalogs. `open`: the segments being written, by number.
  # `closed`: the other segments, oldest first, which is not always the order in which they were created. `ended`: for
  # segments split by size, the time after their latest message. `jumped`: a segment that does not follow the previous
  # one, and the stream that began it.
  defstruct [
    :name,
    :root,
    :opts,
    :cut,
    :keep,
    :owner,
    :run,
    open: %{},
    closed: [],
    ended: %{},
    streams: %{},
    jumped: nil
  ]

  @doc "Starts the process, linked to the caller. It stops when the caller ends."
  @spec start_link({String.t(), Path.t(), keyword()}, SplitPoint.t(), keep()) ::
          GenServer.on_start()
  def start_link({name, root, opts}, cut, keep),
    do: GenServer.start_link(__MODULE__, {name, root, opts, cut, keep, self()})

  @doc "Returns stream `name` in segment `number` (or in the oldest open segment), and that segment's number."
  @spec open_stream(GenServer.server(), integer(), String.t(), keyword()) ::
          {:ok, integer(), Writer.Stream.t()} | {:error, Situ.Error.t()}
  def open_stream(pieces, number, name, opts),
    do: GenServer.call(pieces, {:stream, number, name, opts}, :timer.minutes(1))

  @doc "Reports messages up to `time` in a segment. With splitting by size, this may begin the next segment."
  @spec report_append(GenServer.server(), SplitPoint.t(), integer(), Situ.Time.t()) :: :ok
  def report_append(_pieces, %{newest: nil}, _number, _time), do: :ok

  def report_append(pieces, _cut, number, time),
    do: GenServer.call(pieces, {:appended, number, time}, :infinity)

  @doc "Closes all open segments."
  @spec close_all(GenServer.server()) :: :ok
  def close_all(pieces), do: GenServer.stop(pieces, :normal, :timer.minutes(1))

  @impl true
  def init({name, root, opts, cut, keep, owner}) do
    Process.flag(:trap_exit, true)
    Process.monitor(owner)
    run = "#{Situ.Time.now()}-#{System.pid()}-#{System.unique_integer([:positive])}"
    state = %__MODULE__{name: name, root: root, opts: opts, cut: cut, keep: keep}
    {:ok, %{state | owner: owner, run: run}, {:continue, :find_earlier}}
  end

  @impl true
  def handle_continue(:find_earlier, %{keep: nil} = state), do: {:noreply, state}

  def handle_continue(:find_earlier, state) do
    Draft.delete_abandoned(Path.join(state.root, state.name))
    earlier = EarlierRuns.list_segments(state.name, state.root, monotonic_ns(), Situ.Time.now())
    {:noreply, %{state | closed: earlier}}
  end

  @impl true
  def handle_call({:stream, number, name, opts}, _from, state) do
    number = max(number, oldest_open(state, number))
    state = warn_of_jump(state, number, name)
    new? = not is_map_key(state.open, number)

    with {:ok, state} <- ensure_open(state, number, name),
         {:ok, stream, state} <- fetch_stream(state, number, name, opts) do
      state = close_old(state)
      {:reply, {:ok, number, stream}, if(new?, do: delete_surplus(state), else: state)}
    else
      {:error, _} = error -> {:reply, error, state}
    end
  end

  # The writer waits for the decision, so a fast one cannot write past the size.
  def handle_call({:appended, number, time}, _from, %{cut: %{every: {:bytes, most}}} = state) do
    state = %{state | ended: Map.update(state.ended, number, time + 1, &max(&1, time + 1))}
    bytes = if open = state.open[number], do: Writer.stored_bytes(open.writer), else: 0
    newest = SplitPoint.newest_number(state.cut)

    cond do
      # Split after the latest message of all streams, so that all messages of a segment precede the next segment.
      number == newest and bytes >= most ->
        SplitPoint.begin_segment(state.cut, state.ended[number])

      # One stream's times are far ahead of the others', which keep filling the segment that should have ended.
      number == newest - 1 and bytes >= most + div(most, 4) ->
        SplitPoint.lower_start(state.cut, time + 1)

      true ->
        :ok
    end

    {:reply, :ok, state}
  end

  @impl true
  def handle_info({:DOWN, _, :process, owner, _}, %{owner: owner} = state),
    do: {:stop, :normal, state}

  def handle_info(_other, state), do: {:noreply, state}

  @impl true
  def terminate(_reason, state),
    do: Enum.each(state.open, fn {_, open} -> Writer.close(open.writer) end)

  defp oldest_open(%{open: open}, number) when map_size(open) == 0, do: number
  defp oldest_open(%{open: open}, _number), do: open |> Map.keys() |> Enum.min()

  defp ensure_open(%{open: open} = state, number, _stream) when is_map_key(open, number),
    do: {:ok, state}

  defp ensure_open(state, number, stream) do
    every = if is_integer(state.cut.every), do: state.cut.every
    jump? = every != nil and state.open != %{} and not is_map_key(state.open, number - 1)

    with {:ok, writer} <- Writer.create(state.name, state.root, state.opts),
         {:ok, _} <-
           Writer.append_catalog(writer, %{
             kind: "piece",
             every: every,
             run: state.run,
             number: number
           }) do
      OpenRecordings.add_writer(writer)
      wake_readers(state.open)

      piece = %{
        writer: writer,
        path: writer.path,
        order: {:this_run, number},
        # A segment that a stream has jumped to may be incomplete until another segment follows it.
        duration: if(jump?, do: 0, else: every),
        ended: nil,
        size: 0
      }

      open = state.open |> put_duration(number - 1, every) |> Map.put(number, piece)

      jumped =
        if jump? and number > newest_open(state.open), do: {number, stream}, else: state.jumped

      {:ok, %{state | open: open, jumped: jumped}}
    end
  end

  # A reader that follows the recording waits for new entries in the segments that it knows.
  defp wake_readers(open),
    do: for({_, %{writer: writer}} <- open, do: Writer.append_catalog(writer, %{kind: "piece"}))

  defp newest_open(open), do: open |> Map.keys() |> Enum.max()

  defp put_duration(open, number, every) when is_map_key(open, number),
    do: put_in(open[number].duration, every)

  defp put_duration(open, _number, _every), do: open

  defp fetch_stream(%{streams: streams} = state, number, name, _opts)
       when is_map_key(streams, {number, name}),
       do: {:ok, streams[{number, name}], state}

  defp fetch_stream(state, number, name, opts) do
    with {:ok, stream} <- Writer.stream(state.open[number].writer, name, opts),
         do: {:ok, stream, %{state | streams: Map.put(state.streams, {number, name}, stream)}}
  end

  # Closes all segments except the two newest.
  defp close_old(state) do
    done = state.open |> Map.keys() |> Enum.sort(:desc) |> Enum.drop(2)
    Enum.reduce(Enum.reverse(done), state, &close_segment/2)
  end

  defp close_segment(number, state) do
    {%{writer: writer} = piece, open} = Map.pop(state.open, number)
    # A failure here only affects how much of the recording later runs keep.
    _ = if piece.duration != 0, do: Writer.append_catalog(writer, %{kind: "piece", full: true})
    OpenRecordings.remove_writer(writer)
    _ = Writer.close(writer)

    piece =
      piece
      |> Map.delete(:writer)
      |> Map.merge(%{ended: monotonic_ns(), size: Folder.total_size(piece.path)})

    %{
      state
      | open: open,
        closed: Enum.sort_by([piece | state.closed], & &1.order),
        ended: Map.delete(state.ended, number),
        streams: Map.reject(state.streams, fn {{n, _}, _} -> n == number end)
    }
  end

  defp delete_surplus(state) do
    open =
      for {_, piece} <- Enum.sort(state.open),
          do: %{piece | size: Folder.total_size(piece.path)}

    {surplus, closed} =
      Enum.split(
        state.closed,
        Retention.count_surplus(state.keep, state.closed, open, monotonic_ns())
      )

    # A segment that another program is writing cannot be deleted and is left to the next run.
    for piece <- surplus, do: Maintenance.delete(piece.path)
    %{state | closed: closed}
  end

  defp monotonic_ns, do: System.monotonic_time(:nanosecond)

  # Other streams still fill segments before the one that a stream has jumped to, so its clock is probably incorrect.
  # After a gap in all streams, no stream would fill earlier segments.
  defp warn_of_jump(%{jumped: {jumped, name}, cut: %{every: every}} = state, number, other)
       when number < jumped and not is_map_key(state.open, number) and other != name do
    Logger.warning(
      "#{state.name}: #{inspect(name)} is #{Situ.Time.format_duration((jumped - number) * every)} " <>
        "ahead of #{inspect(other)}: the originating times of one of them are probably incorrect. All data is " <>
        "recorded, and `keep:` deletes nothing because of it."
    )

    %{state | jumped: nil}
  end

  defp warn_of_jump(state, _number, _other), do: state
end
