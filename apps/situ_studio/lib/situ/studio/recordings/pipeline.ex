defmodule Situ.Studio.Recordings.Pipeline do
  @moduledoc false
  # Opens a running pipeline as a recording of its named streams, which are tapped when they are
  # drawn. Messages remain available for five minutes, even after the pipeline has ended.
  @behaviour Situ.Recording

  alias Situ.{Error, Pipeline, Recording}
  alias Situ.Studio.{PipelineWatcher, StreamInfo}
  alias Situ.Studio.Recordings.History

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

  @doc "Opens the pipeline called `title`, watched under `supervisor`."
  @spec open([spec()], String.t(), Supervisor.supervisor()) ::
          {:ok, Recording.t()} | {:error, Error.t()}
  def open(specs, title, supervisor) do
    case List.keyfind(list_running(specs), title, 0) do
      {_, target} ->
        {:ok, pid} = DynamicSupervisor.start_child(supervisor, {PipelineWatcher, target})
        {:ok, %Recording{module: __MODULE__, state: PipelineWatcher.reader_handle(pid)}}

      nil ->
        {:error, Error.new(:not_running, "pipeline #{inspect(title)} is not running")}
    end
  end

  # Before the first message, the extent is the current time of the pipeline's clock, which a replay sets to the time of
  # its recording.
  @impl true
  def info(watch) do
    {:ok, _streams, running?} = list_watched(watch)
    info = %{name: nil, created: nil, closed?: not running?, live?: running?, damage: []}
    if any_messages?(watch), do: info, else: Map.put(info, :now, PipelineWatcher.now(watch))
  end

  defp any_messages?(watch), do: :ets.info(watch.history.messages, :size) not in [0, :undefined]

  @impl true
  def streams(watch) do
    {:ok, named, _} = list_watched(watch)
    received = Map.new(History.streams(watch.history), &{&1.name, &1})

    declared =
      for {name, type} <- named do
        known = Map.get(received, name, History.empty_info(name))
        %{known | type: parse_type(known, type), extra: Map.put(known.extra, :type, type)}
      end

    declared ++ (received |> Map.drop(Enum.map(named, &elem(&1, 0))) |> Map.values())
  end

  # Messages are more precise than the declared type.
  defp parse_type(%{count: 0}, text), do: StreamInfo.parse_type(text)
  defp parse_type(%{type: type}, _text), do: type

  defp list_watched(watch) do
    with {:error, error} <- PipelineWatcher.list_streams(watch), do: raise(error)
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
  def request_streams(watch, names),
    do: Enum.each(names, &PipelineWatcher.request_stream(watch, &1))

  # The earlier messages of a stream remain available if it cannot be tapped.
  @impl true
  def stream(watch, name) do
    case PipelineWatcher.request_stream(watch, name) do
      :ok ->
        History.stream(watch.history, name)

      {:error, %{code: :not_running}} ->
        History.stream(watch.history, name)

      {:error, error} ->
        case PipelineWatcher.list_streams(watch) do
          {:ok, _, false} -> History.stream(watch.history, name)
          _ -> {:error, error}
        end
    end
  end

  @impl true
  def seek(watch, info, time), do: History.seek(watch.history, info, time)

  @impl true
  def read(watch, info, ordinal, to, limit, opts),
    do: History.read(watch.history, info, ordinal, to, limit, opts)
end
