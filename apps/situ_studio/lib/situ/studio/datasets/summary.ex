defmodule Situ.Studio.Datasets.Summary do
  @moduledoc false
  # Summarizes a recording or a dataset for lists: times, streams, size, sessions, or the error
  # that prevents opening it.
  alias Situ.{Dataset, Error, Store}
  alias Situ.Studio.{StreamTotals, StreamInfo, StreamOverview, StreamReader, Recordings}

  defstruct streams: [],
            from: nil,
            to: nil,
            size: 0,
            sessions: nil,
            segments: 0,
            pauses: 0,
            live: false,
            damaged: false,
            error: nil

  @type t :: %__MODULE__{
          streams: [StreamInfo.t()],
          from: Situ.Time.t() | nil,
          to: Situ.Time.t() | nil,
          size: non_neg_integer(),
          sessions: non_neg_integer() | nil,
          segments: non_neg_integer(),
          pauses: non_neg_integer(),
          live: boolean(),
          damaged: boolean(),
          error: Error.t() | nil
        }

  @doc "Opens the recording at a path and summarizes it."
  @spec of_recording(Path.t()) :: t()
  def of_recording(path) do
    case Recordings.Store.open(path) do
      {:ok, source} -> source |> of_source() |> use_file_size(path) |> put_segments(source)
      {:error, error} -> %__MODULE__{error: error}
    end
  end

  defp put_segments(facts, %{state: %{recording: recording}}) do
    segments = Store.segments(recording)
    %{facts | segments: length(segments), pauses: count_pauses(segments)}
  end

  @pause 1_000_000_000

  # Between two runs of the recorder there is a gap in all streams.
  defp count_pauses(segments) do
    segments
    |> Enum.filter(& &1.first)
    |> Enum.chunk_every(2, 1, :discard)
    |> Enum.count(fn [one, next] -> one.run != next.run and next.first - one.last >= @pause end)
  end

  # The decoded streams of a video are much larger than its file, so a single-file recording has the size of its file.
  defp use_file_size(facts, path) do
    case File.stat(path) do
      {:ok, %{type: :regular, size: size}} when facts.error == nil -> %{facts | size: size}
      _ -> facts
    end
  end

  @doc "Adds up the figures of several recordings."
  @spec sum_figures([t()]) :: StreamTotals.t()
  def sum_figures(facts) do
    sum = facts |> Enum.flat_map(& &1.streams) |> StreamTotals.sum_streams()
    %{sum | bytes: facts |> Enum.map(& &1.size) |> Enum.sum()}
  end

  @doc "Returns the number of sessions in a dataset file. Does not open its recordings, as there may be thousands."
  @spec of_dataset(Path.t()) :: t()
  def of_dataset(file) do
    case Dataset.load(file) do
      {:ok, dataset} -> %__MODULE__{sessions: length(dataset.sessions)}
      {:error, error} -> %__MODULE__{error: error}
    end
  end

  @doc "Summarizes a source that is already open, such as streams in memory."
  @spec of_source(Situ.Recording.t()) :: t()
  def of_source(source) do
    with {:ok, streams} <- StreamOverview.list_streams(source),
         {:ok, extent} <- StreamReader.fetch_extent(source) do
      timed? = Enum.any?(streams, & &1.first)

      %__MODULE__{
        streams: streams,
        from: if(timed?, do: extent.from),
        to: if(timed?, do: extent.to),
        size: streams |> Enum.map(& &1.bytes) |> Enum.sum(),
        live: extent.live,
        damaged: StreamReader.list_damage(source) != []
      }
    else
      {:error, error} -> %__MODULE__{error: error}
    end
  end

  @doc "Combines the summaries of several recordings."
  @spec merge_facts([t()]) :: t()
  def merge_facts(facts) do
    %__MODULE__{
      streams: Enum.flat_map(facts, & &1.streams),
      from: facts |> Enum.map(& &1.from) |> Enum.reject(&is_nil/1) |> Enum.min(fn -> nil end),
      to: facts |> Enum.map(& &1.to) |> Enum.reject(&is_nil/1) |> Enum.max(fn -> nil end),
      size: facts |> Enum.map(& &1.size) |> Enum.sum(),
      live: Enum.any?(facts, & &1.live),
      damaged: Enum.any?(facts, &(&1.damaged or &1.error != nil))
    }
  end

  @doc """
  Formats the duration for people. Returns an empty string if there are no messages.

      iex> Situ.Studio.Datasets.Summary.format_duration(%Situ.Studio.Datasets.Summary{from: 0, to: 90_000_000_000})
      "1 min 30 s"
  """
  @spec format_duration(t()) :: String.t()
  def format_duration(%__MODULE__{from: nil}), do: ""
  def format_duration(%__MODULE__{from: from, to: to}), do: Situ.Time.format_duration(to - from)

  @doc "Returns a stamp of the recording's files that changes when the recording is replaced or grows."
  @spec file_stamp(Path.t()) :: term()
  def file_stamp(path) do
    # A path without a version means the newest version.
    folder =
      if File.exists?(path),
        do: path,
        else: Store.newest(Path.basename(path), Path.dirname(path)) || path

    index = Path.join(folder, "index.situ")

    case File.stat(if(Store.exists?(folder) and File.exists?(index), do: index, else: folder)) do
      {:ok, stat} -> {stat.size, stat.mtime, stat.inode}
      {:error, reason} -> segments_stamp(path) || reason
    end
  end

  # Only the newest segments grow, and segments are deleted as a whole.
  defp segments_stamp(path) do
    folders = Situ.Store.Folder.list_versions(Path.basename(path), Path.dirname(path))

    if folders != [],
      do: {length(folders), hd(folders), folders |> Enum.take(-2) |> Enum.map(&file_stamp/1)}
  end
end
