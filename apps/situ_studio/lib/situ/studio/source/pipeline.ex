defmodule Situ.Studio.Source.Pipeline do
  @moduledoc """
  Provides a running pipeline as a source: its named streams, which are tapped when they are drawn. Messages remain
  available for five minutes, even after the pipeline has ended.
  """
  @behaviour Situ.Studio.Source

  alias Situ.{Error, Pipeline}
  alias Situ.Studio.{Source, StreamInfo, PipelineWatcher}
  alias Situ.Studio.Source.History

  @typedoc """
  A pipeline, or a function that finds it again (for a pipeline that a supervisor restarts), with or without a title.
  `{:all, find}` has a function that finds several pipelines, such as `Situ.Cluster.pipelines/0`.
  """
  @type spec ::
          Pipeline.target()
          | (() -> Pipeline.target())
          | {String.t(), spec()}
          | {:all, (() -> [spec()])}

  @doc "Lists the pipelines among `specs` that are running, with their titles."
  @spec list_running([spec()]) :: [{String.t(), Pipeline.target() | (() -> Pipeline.target())}]
  def list_running(specs) do
    for spec <- specs,
        one <- expand_spec(spec),
        {title, target} <- [with_title(one)],
        title != nil,
        do: {title, target}
  end

  # The pipelines of a cluster change over time.
  defp expand_spec({:all, find}) when is_function(find, 0), do: find.()
  defp expand_spec(spec), do: [spec]

  defp with_title({title, target}) when is_binary(title),
    do: {pipeline_name(target) && title, target}

  defp with_title(target), do: {pipeline_name(target), target}

  defp pipeline_name(target) do
    Pipeline.info(PipelineWatcher.resolve_target(target)).pipeline
  rescue
    _ in [Error, ArgumentError, FunctionClauseError] -> nil
  catch
    :exit, _ -> nil
  end

  @doc "Opens a source for the pipeline called `title`, watched under `supervisor`."
  @spec open([spec()], String.t(), Supervisor.supervisor()) ::
          {:ok, Source.t()} | {:error, Error.t()}
  def open(specs, title, supervisor) do
    case List.keyfind(list_running(specs), title, 0) do
      {_, target} ->
        {:ok, pid} = DynamicSupervisor.start_child(supervisor, {PipelineWatcher, target})
        {:ok, {__MODULE__, PipelineWatcher.reader_handle(pid)}}

      nil ->
        {:error, Error.new(:not_running, "pipeline #{inspect(title)} is not running")}
    end
  end

  @impl true
  def extent(watch) do
    with {:ok, streams, running?} <- PipelineWatcher.list_streams(watch),
         {:ok, extent} <- History.extent(watch.history) do
      extent = %{extent | live: running?, version: length(streams)}

      {:ok,
       if(any_messages?(watch), do: extent, else: at_clock(extent, PipelineWatcher.now(watch)))}
    end
  end

  # Before the first message, the extent is the current time of the pipeline's clock, which a replay sets to the time of
  # its recording.
  defp any_messages?(watch), do: :ets.info(watch.history.messages, :size) not in [0, :undefined]
  defp at_clock(extent, now), do: %{extent | from: now, to: now}

  @impl true
  def streams(watch) do
    with {:ok, named, _} <- PipelineWatcher.list_streams(watch),
         {:ok, seen} <- History.streams(watch.history) do
      seen = Map.new(seen, &{&1.name, &1})

      infos =
        for {name, type} <- named do
          known = Map.get(seen, name, %StreamInfo{name: name, shape: :value})
          shape = if known.count > 0, do: known.shape, else: StreamInfo.shape_of_text(type)
          %{known | type: type, shape: shape}
        end

      {:ok, Enum.sort_by(infos, & &1.name)}
    end
  end

  @doc "Returns the pipeline's current graph and statistics, for the page of its graph."
  @spec snapshot(PipelineWatcher.t()) ::
          {:ok, Situ.Diagnostics.Snapshot.t()} | {:error, Error.t()}
  def snapshot(watch), do: PipelineWatcher.fetch_snapshot(watch)

  @doc "Traces the message of one originating time."
  @spec trace(PipelineWatcher.t(), Situ.Time.t()) ::
          {:ok, Situ.Diagnostics.Trace.t()} | {:error, Error.t()}
  def trace(watch, time), do: PipelineWatcher.trace_message(watch, time)

  @impl true
  def wanted(watch, streams), do: Enum.each(streams, &PipelineWatcher.request_stream(watch, &1))

  @impl true
  def series(watch, stream, from, to, bin),
    do: read_wanted(watch, stream, &History.series(&1, stream, from, to, bin))

  @impl true
  def messages(watch, stream, from, to, limit),
    do: read_wanted(watch, stream, &History.messages(&1, stream, from, to, limit))

  @impl true
  def marks(watch, stream, from, to, limit),
    do: read_wanted(watch, stream, &History.marks(&1, stream, from, to, limit))

  @impl true
  def sample(watch, stream, from, to, n),
    do: read_wanted(watch, stream, &History.sample(&1, stream, from, to, n))

  @impl true
  def latest_at(watch, stream, time),
    do: read_wanted(watch, stream, &History.latest_at(&1, stream, time))

  @impl true
  def next_after(watch, stream, time),
    do: read_wanted(watch, stream, &History.next_after(&1, stream, time))

  # The earlier messages of a stream remain available if it cannot be tapped.
  defp read_wanted(watch, stream, read) do
    case PipelineWatcher.request_stream(watch, stream) do
      :ok ->
        read.(watch.history)

      {:error, %{code: :not_running}} ->
        read.(watch.history)

      {:error, error} ->
        case PipelineWatcher.list_streams(watch) do
          {:ok, _, false} -> read.(watch.history)
          _ -> {:error, error}
        end
    end
  end
end
