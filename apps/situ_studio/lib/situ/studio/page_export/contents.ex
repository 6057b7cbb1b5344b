defmodule Situ.Studio.PageExport.Contents do
  @moduledoc false
  # Collects the data of an exported page: for each drawn stream its messages between the two times, as the frames of
  # the data socket (`Situ.Studio.Frame`), from which the page takes its replies
  # (`assets/js/offline/page_data.js`).
  #
  # The bytes are the sizes of the list and of the frames (64 bits each), the list of entries as JSON, one reply with
  # all frames, and sound as 16-bit samples; each part begins at a multiple of 8.
  alias Situ.{Error, Store}
  alias Situ.Studio.{Draw, Frame, PageExport, StreamReader, ValuePath, Visualizers}
  alias Situ.Studio.PageExport.{Pictures, Sounds}

  # With more messages, a line is a summary.
  @most_messages 200_000
  @summary_bins 20_000
  # Windows with this many messages contain each of them.
  @part 1_000
  # The most messages of a panel that shows the message at the cursor, by the visualizer.
  @most_instants %{
    "image" => 400,
    "depth" => 60,
    "masks" => 200,
    "space" => 100,
    "frames" => 400
  }
  @usual_instants 5_000
  # These are drawn from the messages of consecutive windows. Intervals may be anywhere in their stream.
  @in_parts ["line", "lines", "latency", "states", "messages"]
  @in_one ["labels", "spans"]
  # A map shows the way, and the position at the cursor with its accuracy.
  @in_both ["map"]
  # Spectra are computed by a separate script.
  @left_out ["spectrogram"]

  @typep entry :: %{String.t() => term()}

  @doc "Returns the bytes, and sentences about reduced streams."
  @spec collect(PageExport.t(), Situ.Recording.t(), (float() -> term())) ::
          {:ok, binary(), [String.t()]} | {:error, Error.t()}
  def collect(export, source, progress) do
    drawn = list_drawn(export)
    count = max(length(drawn), 1)

    {entries, {frames, _next, notes}} =
      drawn
      |> Enum.with_index()
      |> Enum.map_reduce({[], 0, []}, fn {spec, i}, {frames, next, notes} ->
        progress.(i / count)
        {entry, own, said} = collect_stream(export, source, spec)
        {number_frames(entry, next), {[frames | own], next + length(own), notes ++ said}}
      end)

    {sounds, samples, silent} = Sounds.collect(export, source, sound_streams(drawn))
    progress.(1.0)
    list = Situ.JSON.encode(%{"entries" => entries, "sounds" => sounds})
    {:ok, join_parts(export, list, List.flatten(frames, []), samples), Enum.uniq(notes ++ silent)}
  end

  defp join_parts(export, list, frames, samples) do
    meta = %{request: 0, from: export.from, to: export.to, time: export.from}
    reply = frames |> Frame.encode_reply(meta) |> IO.iodata_to_binary()

    IO.iodata_to_binary([
      <<byte_size(list)::little-64, byte_size(reply)::little-64>>,
      pad_bytes(list),
      pad_bytes(reply),
      samples
    ])
  end

  defp pad_bytes(bytes), do: [bytes, :binary.copy(<<0>>, rem(8 - rem(byte_size(bytes), 8), 8))]

  # Every stream of every panel, with the data that the page requests from the server.
  defp list_drawn(export) do
    for panel <- export.layout.panels,
        v <- panel.vis,
        {:ok, viz} <- [Visualizers.fetch_by_id(v.viz, export.visualizers)],
        {:ok, path} <- [ValuePath.parse(v.path)],
        uniq: true do
      %{stream: v.stream, viz: viz, path: path, text: v.path, props: asked_props(panel, viz, v)}
    end
  end

  # The script of 3D panels chooses the properties that it asks with.
  defp asked_props(%{panel: :space}, _viz, v), do: v.props

  defp asked_props(_panel, viz, v),
    do: Map.take(v.props, Enum.map(viz.asks, &Atom.to_string/1))

  defp sound_streams(drawn),
    do: for(%{viz: %{id: "waveform"}, stream: stream} <- drawn, uniq: true, do: stream)

  # Frame numbers within a stream become numbers within the page.
  @spec number_frames(entry(), non_neg_integer()) :: entry()
  defp number_frames(entry, next) do
    Map.new(entry, fn
      {key, numbers} when key in ["windows", "instants"] -> {key, Enum.map(numbers, &(&1 + next))}
      other -> other
    end)
  end

  defp collect_stream(export, source, spec) do
    entry = %{
      "stream" => spec.stream,
      "viz" => spec.viz.id,
      "path" => spec.text,
      "props" => spec.props
    }

    cond do
      spec.viz.plugin != nil or spec.viz.script != nil or spec.viz.id in @left_out ->
        {entry, [], ["#{spec.stream}: #{spec.viz.title} is not part of an exported page."]}

      spec.viz.id in @in_both ->
        {drawn, frames, notes} = collect_window(entry, export, source, spec)
        {entry, own, more} = collect_instants(drawn, export, source, spec)
        {number_instants(entry, length(frames)), frames ++ own, notes ++ more}

      implements?(spec.viz, :window, [6]) ->
        collect_window(entry, export, source, spec)

      implements?(spec.viz, :instant, [3, 4]) ->
        collect_instants(entry, export, source, spec)

      true ->
        {entry, [], []}
    end
  end

  defp collect_window(entry, export, source, spec) do
    {frames, notes} = window_frames(export, source, spec)
    {Map.put(entry, "windows", list_indexes(frames)), frames, notes}
  end

  defp collect_instants(entry, export, source, spec) do
    {times, frames, notes} = instant_frames(export, source, spec)
    more = %{"instants" => list_indexes(frames), "times" => times}
    {Map.merge(entry, more), frames, notes}
  end

  defp number_instants(entry, next),
    do: Map.update!(entry, "instants", fn numbers -> Enum.map(numbers, &(&1 + next)) end)

  defp list_indexes(frames), do: Enum.to_list(0..(length(frames) - 1)//1)

  defp implements?(%{module: module}, function, arities) do
    Code.ensure_loaded?(module) and Enum.any?(arities, &function_exported?(module, function, &1))
  end

  defp window_frames(%{from: from, to: to} = export, source, %{viz: %{id: id}} = spec) do
    count = count_messages(export, source, spec.stream)

    cond do
      id in @in_parts and count <= @most_messages ->
        ranges = split_range(export, source, spec.stream, count)
        {for({a, b} <- ranges, do: draw_window(source, spec, a, b, 1)), []}

      id in @in_one and count <= @most_messages ->
        {[draw_window(source, spec, from, to, 1)], []}

      true ->
        frame = draw_window(source, spec, from, to, max(div(to - from, @summary_bins), 1))
        {[frame], summary_note(id, spec.stream, count)}
    end
  end

  defp summary_note(id, stream, count) when id in @in_parts or id in @in_one,
    do: ["#{stream}: a summary of its #{count} messages."]

  defp summary_note(_id, _stream, _count), do: []

  defp draw_window(source, spec, from, to, bin),
    do: IO.iodata_to_binary(Draw.draw_window(source, 0, spec, from, to, bin))

  defp count_messages(%{from: from, to: to}, source, stream) do
    with {:ok, info} <- Store.stream_info(source, stream),
         {:ok, count} <- Store.count(source, info, from, to),
         do: count,
         else: (_ -> 0)
  end

  # Splits the time so that each part has few enough messages for all of them to be drawn.
  defp split_range(%{from: from, to: to}, _source, _stream, count) when count <= @part,
    do: [{from, to}]

  defp split_range(%{from: from, to: to} = export, source, stream, count) do
    times = message_times(export, source, stream, count)

    times
    |> Enum.chunk_every(@part)
    |> Enum.map(&{hd(&1), List.last(&1)})
    |> stretch_ends(from, to)
  end

  defp stretch_ends([], from, to), do: [{from, to}]

  defp stretch_ends([{_, b} | rest], from, to) do
    {parts, [{a, _}]} = Enum.split([{from, b} | rest], length(rest))
    parts ++ [{a, to}]
  end

  defp message_times(%{from: from, to: to}, source, stream, count) do
    case StreamReader.read_marks(source, stream, from, to, max(count, 1)) do
      {:ok, marks, _} -> Enum.map(marks, &elem(&1, 0))
      {:error, _} -> []
    end
  end

  # The messages of a stream, beginning with the last one at or before the first time. Too many are thinned evenly.
  defp instant_frames(export, source, spec) do
    count = count_messages(export, source, spec.stream)

    times =
      opening_time(export, source, spec.stream) ++
        message_times(export, source, spec.stream, count)

    times = Enum.dedup(times)
    most = Map.get(@most_instants, spec.viz.id, @usual_instants)
    kept = thin(times, most)

    pairs =
      for time <- kept,
          {:ok, frame} <- [draw_instant(source, spec, time)],
          do: {Integer.to_string(time), frame}

    {times_kept, frames} = Enum.unzip(pairs)
    {times_kept, frames, thin_note(spec, length(times), length(kept))}
  end

  defp opening_time(%{from: from}, source, stream) do
    case StreamReader.latest_at(source, stream, from) do
      {:ok, message} -> [message.originating_time]
      _ -> []
    end
  end

  @doc """
  Returns at most `most` elements of a list, evenly spaced and with the first.

      iex> Situ.Studio.PageExport.Contents.thin(Enum.to_list(0..9), 4)
      [0, 3, 6, 9]
      iex> Situ.Studio.PageExport.Contents.thin([1, 2], 4)
      [1, 2]
  """
  @spec thin([element], pos_integer()) :: [element] when element: term()
  def thin(list, most), do: Enum.take_every(list, max(ceil(length(list) / most), 1))

  defp thin_note(_spec, all, all), do: []

  defp thin_note(spec, all, kept),
    do: ["#{spec.stream}: #{kept} of #{all} messages, evenly spaced."]

  defp draw_instant(source, %{viz: %{id: "image"}} = spec, time) do
    with {:ok, message} <- StreamReader.latest_at(source, spec.stream, time),
         {:ok, data} <- ValuePath.fetch(message.data, spec.path),
         {:ok, picture} <- Pictures.make_small(data) do
      {:ok, IO.iodata_to_binary(Frame.image(0, time, picture))}
    else
      _ -> :none
    end
  end

  defp draw_instant(source, spec, time) do
    {frame, _} = Draw.draw_instant(source, 0, spec, time, nil)
    {:ok, IO.iodata_to_binary(frame)}
  end
end
