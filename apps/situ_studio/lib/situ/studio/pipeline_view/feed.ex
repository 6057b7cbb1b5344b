defmodule Situ.Studio.PipelineView.Feed do
  @moduledoc false
  # Provides snapshots of a pipeline: from a running pipeline (`Situ.Studio.Recordings.Pipeline`), or from a
  # stream of snapshots in a recording.
  alias Situ.{Error, Message, Recording}
  alias Situ.Diagnostics.{Edge, Node, Snapshot, Trace, Window}
  alias Situ.Studio.{Recordings, StreamOverview, StreamReader}

  @type t :: {:live, Recording.t()} | {:recorded, Recording.t(), stream :: String.t()}

  @spec open(Recording.t()) :: {:ok, t()} | {:error, Error.t()}
  # A page's derived streams do not belong to the pipeline.
  def open(%{state: %Recordings.DerivedStreams{recording: source}}), do: open(source)

  def open(%Recording{module: Recordings.Pipeline} = source), do: {:ok, {:live, source}}
  def open(%Recording{} = source), do: open_recorded(source)

  # A reader creates no atoms, so the atoms of these structs must exist before.
  @structs [Snapshot, Node, Edge, Window, Situ.Diagnostics.Process]

  defp open_recorded(source) do
    Enum.each(@structs, &Code.ensure_loaded/1)

    with {:ok, streams} <- StreamOverview.list_streams(source) do
      case Enum.find(streams, &diagnostics_stream?(source, &1)) do
        nil ->
          {:error,
           Error.new(:no_diagnostics, "this recording does not contain diagnostics of a pipeline",
             fix: "run the pipeline with diagnostics: true and write its Diagnostics stream"
           )}

        info ->
          {:ok, {:recorded, source, info.name}}
      end
    end
  end

  # Recognizes a diagnostics stream by its type or, if the type is unknown, by its name and its last message.
  defp diagnostics_stream?(source, info) do
    type = to_string(info.type)

    String.contains?(type, "Diagnostics.Snapshot") or
      (info.last != nil and info.name =~ ~r/diagnostics/i and
         match?(
           {:ok, %Message{data: %Snapshot{}}},
           StreamReader.latest_at(source, info.name, info.last)
         ))
  end

  @doc "Fetches the current snapshot (live, or the newest recorded one) and its time."
  @spec fetch_latest(t()) :: {:ok, Snapshot.t(), Situ.Time.t()} | {:error, Error.t()}
  def fetch_latest({:live, source}) do
    with {:ok, %Snapshot{} = snapshot} <- Recordings.Pipeline.snapshot(source.state),
         do: {:ok, without_taps(snapshot), System.monotonic_time(:nanosecond)}
  end

  def fetch_latest({:recorded, source, _} = feed) do
    with {:ok, extent} <- StreamReader.fetch_extent(source), do: fetch_at(feed, extent.to)
  end

  @doc "Traces the message of one originating time in a running pipeline, leaving out the studio's own taps."
  @spec fetch_trace(t(), Situ.Time.t()) :: {:ok, Trace.t()} | {:error, Error.t()}
  def fetch_trace({:live, source}, time) do
    with {:ok, %Trace{} = trace} <- Recordings.Pipeline.trace(source.state, time) do
      own? = &String.starts_with?(&1, "Studio: ")

      {:ok,
       %{
         trace
         | hops: Enum.reject(trace.hops, &own?.(&1.to)),
           inside: Enum.reject(trace.inside, own?)
       }}
    end
  end

  def fetch_trace(_recorded, _time),
    do: {:error, Error.new(:not_running, "only a running pipeline can be traced")}

  # The studio's own taps are not part of the pipeline.
  @spec without_taps(Snapshot.t()) :: Snapshot.t()
  def without_taps(snapshot) do
    taps = for %{kind: :tap, path: "Studio: " <> _, id: id} <- snapshot.nodes, do: id

    %{
      snapshot
      | nodes: Enum.reject(snapshot.nodes, &(&1.id in taps)),
        edges: Enum.reject(snapshot.edges, &(&1.to in taps))
    }
  end

  @doc "Fetches the last recorded snapshot at or before a time."
  @spec fetch_at(t(), Situ.Time.t()) :: {:ok, Snapshot.t(), Situ.Time.t()} | {:error, Error.t()}
  def fetch_at({:recorded, source, stream}, time) do
    case StreamReader.latest_at(source, stream, time) do
      {:ok, %Message{data: %Snapshot{} = snapshot, originating_time: taken}} ->
        {:ok, fill_edge_fields(snapshot), taken}

      {:error, error} ->
        {:error, error}

      _ ->
        {:error, Error.new(:no_diagnostics, "no snapshot was recorded at or before that time")}
    end
  end

  # Edges in older recordings may lack newer fields.
  defp fill_edge_fields(snapshot),
    do: %{snapshot | edges: Enum.map(snapshot.edges, &struct(Edge, Map.delete(&1, :__struct__)))}

  @doc "Lists the times of at most `limit` recorded snapshots, evenly thinned."
  @spec list_times(t(), pos_integer()) :: [Situ.Time.t()]
  def list_times({:recorded, source, stream}, limit) do
    with {:ok, %{from: from, to: to}} <- StreamReader.fetch_extent(source),
         {:ok, marks, _} <- StreamReader.read_marks(source, stream, from, to, limit) do
      Enum.map(marks, &elem(&1, 0))
    else
      _ -> []
    end
  end

  def list_times(_, _), do: []

  @doc "Lists the last messages of a stream up to a time (`:now` if live), newest first. Reads them only on demand."
  @spec list_messages(t(), String.t(), Situ.Time.t() | :now, pos_integer()) :: [Message.t()]
  def list_messages(feed, stream, time, n) do
    source = elem(feed, 1)

    case {time, StreamReader.fetch_extent(source)} do
      {:now, {:ok, %{to: to}}} -> take_earlier(source, stream, to, n)
      {time, {:ok, _}} when is_integer(time) -> take_earlier(source, stream, time, n)
      _ -> []
    end
  end

  defp take_earlier(_source, _stream, _time, 0), do: []

  defp take_earlier(source, stream, time, n) do
    case StreamReader.latest_at(source, stream, time) do
      {:ok, %Message{} = message} ->
        [message | take_earlier(source, stream, message.originating_time - 1, n - 1)]

      _ ->
        []
    end
  end
end
