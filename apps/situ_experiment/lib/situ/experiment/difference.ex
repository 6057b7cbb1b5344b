defmodule Situ.Experiment.Difference do
  @moduledoc false
  # A recording that shows where the outputs of two sets differ in one session: the streams of the baseline, of the
  # other set and the truth, and `Differences`, a message for each interval in which the outputs are not equal. The
  # studio steps from one to the next.
  # See docs/adr/0181-differences-of-outputs-are-recordings.md.
  alias Situ.{Annotation, Error, Store}
  alias Situ.Dataset.{OpenSession, StoreVersion}
  alias Situ.Experiment.DifferentTimes
  alias Situ.Metric.StreamReader

  @stream "Differences"

  @typedoc "The recordings of the outputs of a session; without a baseline, the set is compared with the truth."
  @type outputs :: %{run: Path.t(), baseline: Path.t() | nil}

  @doc "Returns the name of the stream with the differences."
  @spec stream_name() :: String.t()
  def stream_name, do: @stream

  @doc """
  Writes the next version of the recording `path`, and returns its folder. `metrics` are the metrics of a run
  (`Situ.Metric.StoredMetric`); metrics that compare no streams are left out. Error: `:no_compared_streams`.
  """
  @spec write_recording(Path.t(), OpenSession.t(), outputs(), {[map()], title :: String.t()}) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def write_recording(path, %OpenSession{} = session, outputs, {metrics, title}) do
    with {:ok, compared} <- list_compared(metrics),
         {:ok, streams} <- build_streams(compared, session, outputs),
         draft = StoreVersion.draft_path(path),
         :ok <- write_streams(draft, streams, title) do
      StoreVersion.publish_draft(draft, path)
    end
  rescue
    error in Error -> {:error, error}
  end

  @doc """
  Returns a description of a recording that `write_recording/4` wrote: its title, the number of differences, and the
  time of the first one.
  """
  @spec describe_recording(Path.t()) ::
          {:ok, %{title: String.t(), count: non_neg_integer(), first: Situ.Time.t() | nil}}
          | {:error, Error.t()}
  def describe_recording(path) do
    with {:ok, store} <- Store.open(path),
         {:ok, info} <- Store.stream_info(store, @stream),
         {:ok, %{"title" => title}} <- Store.metadata(store, @stream) do
      {:ok, %{title: title, count: info.count, first: info.first}}
    end
  end

  @doc """
  Returns the time of the first difference in a stream of the output, or in any for `nil`; `nil` if there is none.
  """
  @spec find_first(Path.t(), String.t() | nil) :: Situ.Time.t() | nil
  def find_first(path, stream) do
    with {:ok, store} <- Store.open(path) do
      store
      |> Store.messages(@stream)
      |> Enum.find_value(fn message ->
        if Enum.any?(message.data, &shows_stream?(&1.track, stream)), do: message.originating_time
      end)
    else
      _ -> nil
    end
  end

  defp shows_stream?(_track, nil), do: true

  defp shows_stream?(track, stream),
    do: track == stream or String.starts_with?(track, stream <> ".")

  # Several metrics may compare the same streams.
  defp list_compared(metrics) do
    compared =
      for %{"kind" => kind, "truth" => truth, "stream" => stream} <- metrics,
          do:
            {if(kind in ["intervals", "classes"], do: :segments, else: :messages), truth, stream,
             kind}

    case Enum.uniq_by(compared, fn {how, truth, stream, _} -> {how, truth, stream} end) do
      [] ->
        {:error,
         Error.new(
           :no_compared_streams,
           "no metric of this run names the streams that it compares",
           why: "it has only functions, or an earlier release of Situ computed it",
           fix: "add a metric with `truth:`, or run the experiment again"
         )}

      compared ->
        {:ok, compared}
    end
  end

  defp build_streams(compared, session, outputs) do
    with {:ok, baseline} <- open_output(outputs.baseline),
         {:ok, run} <- open_output(outputs.run),
         {:ok, parts} <-
           Error.map_ok(compared, &build_part(&1, session, %{baseline: baseline, run: run})) do
      differences = for {_, found} <- parts, difference <- found, do: difference
      {:ok, Enum.flat_map(parts, &elem(&1, 0)) ++ [difference_stream(differences)]}
    end
  end

  defp open_output(nil), do: {:ok, nil}
  defp open_output(path), do: Store.open(path)

  defp build_part({how, truth, stream, kind}, session, stores) do
    with {:ok, true_messages} <- OpenSession.messages(session, truth) do
      sides = %{
        truth: Enum.to_list(true_messages),
        run: read_messages(stores.run, stream),
        baseline: read_messages(stores.baseline, stream)
      }

      {:ok, compare_sides(how, sides, stream, kind)}
    end
  end

  defp read_messages(nil, _stream), do: nil

  defp read_messages(store, stream) do
    if Store.has_stream?(store, stream), do: Enum.to_list(Store.messages(store, stream)), else: []
  end

  # One stream for each track, with the outputs and the truth as lanes.
  defp compare_sides(:segments, sides, stream, kind) do
    sides =
      for {side, messages} <- sides,
          messages != nil,
          into: %{},
          do: {side, read_tracks(messages, kind)}

    tracks = sides |> Map.values() |> Enum.flat_map(&Map.keys/1) |> Enum.uniq() |> Enum.sort()
    parts = Enum.map(tracks, &compare_track(sides, track_name(stream, &1), &1, kind))
    {Enum.map(parts, &elem(&1, 0)), Enum.flat_map(parts, &elem(&1, 1))}
  end

  # Numbers, boxes and texts are copied, and drawn as usual.
  defp compare_sides(:messages, sides, stream, _kind) do
    streams =
      for {side, messages} <- sides, messages not in [nil, []] do
        %{
          name: "#{side_name(side)}.#{stream}",
          type: common_type(messages),
          messages: messages,
          metadata: nil
        }
      end

    found =
      for {from, to, text} <- DifferentTimes.compare_messages(sides), do: {stream, from, to, text}

    {streams, found}
  end

  defp compare_track(sides, name, track, kind) do
    lanes = Map.new(sides, fn {side, tracks} -> {side, Map.get(tracks, track, [])} end)
    compared = if kind == "intervals", do: drop_labels(lanes), else: lanes

    found =
      for {from, to, text} <- DifferentTimes.compare_segments(compared),
          do: {name, from, to, text}

    {lane_stream(name, lanes), found}
  end

  # Metrics of intervals ignore their labels.
  defp drop_labels(lanes) do
    Map.new(lanes, fn {side, segments} ->
      {side, for({from, to, _} <- segments, do: {from, to, "true"})}
    end)
  end

  defp read_tracks(messages, kind) do
    for {track, segments} <- StreamReader.read_segments(messages), into: %{} do
      {track, for({_, _, label} = s <- segments, kind != "intervals" or label != "false", do: s)}
    end
  end

  defp track_name(stream, ""), do: stream
  defp track_name(stream, track), do: "#{stream}.#{track}"

  defp side_name(:run), do: "Set"
  defp side_name(:baseline), do: "Baseline"
  defp side_name(:truth), do: "Truth"

  defp lane_stream(name, lanes) do
    begins = for {_, segments} <- lanes, {from, _, _} <- segments, do: from

    annotations =
      for {side, segments} <- lanes, a <- lane_annotations(side, segments, begins), do: a

    %{
      name: name,
      type: {:list, Annotation},
      messages: Annotation.to_messages(annotations),
      metadata: nil
    }
  end

  # Without an annotation, the lane would be missing. A mark without a duration says that nothing was found.
  defp lane_annotations(_side, [], []), do: []

  defp lane_annotations(side, [], begins) do
    time = Enum.min(begins)
    [Annotation.new(time, time, lane_name(side), %{"Label" => "nothing"})]
  end

  defp lane_annotations(side, segments, _begins) do
    for {from, to, label} <- segments do
      values = if label == "true", do: %{}, else: %{"Label" => label}
      Annotation.new(from, to, lane_name(side), values)
    end
  end

  defp lane_name(side), do: String.downcase(side_name(side))

  # A message is at the time at which its difference begins, so a step to the next message shows the next difference.
  defp difference_stream(differences) do
    messages =
      differences
      |> Enum.group_by(fn {_, from, _, _} -> from end)
      |> Enum.sort()
      |> Enum.map(fn {from, together} ->
        data =
          for {name, a, b, text} <- Enum.sort(together),
              do: Annotation.new(a, b, name, %{"Label" => text})

        %Situ.Message{data: data, originating_time: from, creation_time: from, sequence_id: 0}
      end)

    %{name: @stream, type: {:list, Annotation}, messages: messages, metadata: :title}
  end

  defp common_type(messages) do
    cond do
      Enum.all?(messages, &is_number(&1.data)) -> :number
      Enum.all?(messages, &is_binary(&1.data)) -> :string
      true -> :any
    end
  end

  defp write_streams(draft, streams, title) do
    with {:ok, writer} <- Store.Writer.create(@stream, draft, versioned: false) do
      result = Enum.reduce_while(streams, :ok, &write_stream(&1, &2, {writer, title}))
      closed = Store.Writer.close(writer)

      with :ok <- result, :ok <- closed do
        :ok
      else
        error ->
          StoreVersion.discard_draft(draft)
          error
      end
    end
  end

  defp write_stream(stream, :ok, {writer, title}) do
    options = if stream.metadata == :title, do: [metadata: %{"title" => title}], else: []
    messages = number_messages(stream.messages)

    with {:ok, out} <- Store.Writer.stream(writer, stream.name, [type: stream.type] ++ options),
         {:ok, out} <- Store.Writer.append(out, messages),
         {:ok, _} <- Store.Writer.close_stream(out, last_time(messages)) do
      {:cont, :ok}
    else
      error -> {:halt, error}
    end
  end

  defp number_messages(messages) do
    for {message, n} <- Enum.with_index(messages, 1), do: %{message | sequence_id: n}
  end

  defp last_time([]), do: 0
  defp last_time(messages), do: List.last(messages).originating_time
end
