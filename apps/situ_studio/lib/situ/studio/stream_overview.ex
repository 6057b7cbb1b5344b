defmodule Situ.Studio.StreamOverview do
  @moduledoc false
  # Lists the streams of any recording with their shapes, and reads the signals and summaries that
  # pages draw.
  alias Situ.{Error, Message, Recording, Store}
  alias Situ.Studio.Draw.{Bins, WindowMessages}
  alias Situ.Studio.{StreamInfo, StreamReader, StreamTotals}

  # Up to this many messages are read individually, and up to this many changes are returned.
  @few 2_000
  @changes 2_000
  # Up to this many computed messages are folded into a signal.
  @folded 200_000
  # The shape of a stream is determined from this many messages.
  @inside 8

  @doc "Returns the streams of the recording, sorted by name."
  @spec list_streams(Recording.t()) :: {:ok, [StreamInfo.t()]} | {:error, Error.t()}
  def list_streams(recording) do
    infos =
      for info <- Store.streams(recording),
          do: describe_stream(info, look_inside(recording, info))

    {:ok, Enum.sort_by(infos, & &1.name)}
  rescue
    error in Error -> {:error, error}
  end

  # If a stream's type does not determine its shape or its lanes, some of its messages do.
  defp look_inside(recording, info) do
    case {StreamInfo.shape_of_type(info.type), info} do
      {shape, %{last: nil}} -> {shape, []}
      {shape, _} when shape not in [:value, :states, :spans] -> {shape, []}
      {shape, %{extra: %{shapes: table}}} -> fetch_shape(table, recording, info, shape)
      {shape, _} -> StreamInfo.refine_shape(shape, latest_data(recording, info))
    end
  end

  defp fetch_shape({table, key}, recording, info, shape) do
    with [] <- :ets.lookup(table, {:inside, key}) do
      {:ok, sample} =
        StreamReader.sample_messages(recording, info, info.first, info.last, @inside)

      inside = StreamInfo.refine_shape(shape, for({_, message} <- sample, do: message.data))
      if inside != {:value, []}, do: :ets.insert(table, {{:inside, key}, inside})
      inside
    else
      [{_, inside}] -> inside
    end
  end

  defp latest_data(recording, info) do
    case Store.latest_at(recording, info, info.last) do
      {:ok, %Message{data: data}} -> [data]
      _ -> []
    end
  end

  @doc "Describes a stream of a recording, whose shape and lanes are known."
  @spec describe_stream(Store.StreamInfo.t(), {StreamInfo.shape(), keys :: [String.t()]}) ::
          StreamInfo.t()
  def describe_stream(%Store.StreamInfo{extra: extra} = info, {shape, keys}) do
    %StreamInfo{
      name: info.name,
      shape: shape,
      type: extra[:type] || Situ.Type.to_string(info.type),
      first: info.first,
      last: info.last,
      path: extra[:path],
      count: info.count,
      rate: StreamInfo.mean_rate(extra[:stored] || info.count, info.first, info.last),
      bytes: info.size,
      latency: info.latency_sum && Store.StreamInfo.average_latency(info),
      keys: keys,
      details: list_details(info)
    }
  end

  defp list_details(info) do
    [
      {"On disk", info.stored > 0 && StreamTotals.format_bytes(info.stored)},
      {"Average size", info.count > 0 && StreamTotals.format_bytes(div(info.size, info.count))},
      {"Compression", info.compression != :none && to_string(info.compression)},
      {"Large messages", info.large? && "stored separately"},
      {"First created", info.first_creation && {:time, info.first_creation}},
      {"Last created", info.last_creation && {:time, info.last_creation}},
      {"Opened", info.opened && {:time, info.opened}},
      {"Closed", info.closed && {:time, info.closed}},
      {"Id", info.id && to_string(info.id)}
    ]
    |> Enum.filter(&elem(&1, 1))
  end

  @doc """
  Returns the signal of a numeric or audio stream between two times in bins of `bin` ns, or message by message if
  there are fewer messages than bins. Includes the neighbors just outside, so that lines reach the edges.
  """
  @spec read_series(Recording.t(), String.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, [Situ.Codec.point()], raw? :: boolean()} | {:error, Error.t()}
  def read_series(recording, name, from, to, bin) do
    bins = max(div(to - from, bin), 2)

    with {:ok, info} <- Store.stream_info(recording, name),
         {:ok, n} <- Store.count(recording, info, from, to) do
      if n > bins or elem(look_inside(recording, info), 0) == :audio,
        do: read_summary_points(recording, info, {from, to}, bin, n),
        else: read_points(recording, info, from, to, n)
    end
  end

  defp read_points(recording, info, from, to, n) do
    with {:ok, messages} <- Store.read(recording, info, from: from, to: to, limit: n + 16) do
      {before, later} = WindowMessages.surrounding_messages(recording, info, {from, to}, n)
      {:ok, Enum.flat_map(before ++ messages ++ later, &Bins.message_points/1), true}
    end
  end

  # Without a stored summary, the messages are folded, or a sample of computed messages if there are too many. Bins are
  # aligned in the time of the stream's own recording, so that the signal of a shifted recording does not change.
  defp read_summary_points(recording, %{extra: %{summary: :none}} = info, {from, to}, bin, n) do
    offset = Map.get(info.extra, :offset, 0)

    with {:ok, points} <- read_or_sample_points(recording, info, {from, to}, n) do
      most = max(div(to - from, bin), 2) + 32
      {points, raw?} = points |> Bins.shift_points(-offset) |> Bins.fold_points(bin, most)
      {:ok, Bins.shift_points(points, offset), raw?}
    end
  end

  defp read_summary_points(recording, info, {from, to}, bin, _n) do
    bins = max(div(to - from, bin), 2)

    with {:ok, _width, rows} <- Store.summary(recording, info, from, to, bins),
         do: {:ok, rows, false}
  end

  defp read_or_sample_points(recording, info, {from, to}, n) do
    if n <= @folded or is_map_key(info.extra, :stored) do
      with {:ok, points, true} <- read_points(recording, info, from, to, n), do: {:ok, points}
    else
      with {:ok, messages, _all?} <-
             WindowMessages.fetch_around(recording, %{stream: info}, from, to),
           do: {:ok, Enum.flat_map(messages, &Bins.message_points/1)}
    end
  end

  @doc """
  Returns a summary of many messages without reading them (`Situ.Store.Summary.read/6`). Returns `:none` if there are so
  few messages that reading them is better, and for streams that are computed.
  """
  @spec fetch_summary(Recording.t(), String.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, Store.Summary.t()} | :none | {:error, Error.t()}
  def fetch_summary(recording, name, from, to, bins) do
    with {:ok, info} when not is_map_key(info.extra, :summary) <-
           Store.stream_info(recording, name),
         {:ok, n} when n > @few <- Store.count(recording, info, from, to) do
      # The end of a map's key is visible only in the counts of bins.
      keyed? = elem(look_inside(recording, info), 0) in [:states, :spans, :value]
      changes = if keyed?, do: 0, else: @changes
      Store.Summary.read(recording, info, from, to, bins, changes: changes)
    else
      {:ok, _computed_or_few} -> :none
      error -> error
    end
  end
end
