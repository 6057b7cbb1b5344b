defmodule Situ.Studio.Source.Pipeline do
  @moduledoc """
  A running pipeline as a source: its named streams, tapped when something is drawn of them. Everything seen stays to be
  looked at for five minutes, also after the pipeline has ended.
  """
  @behaviour Situ.Studio.Source

  alias Situ.{Error, Pipeline}
  alias Situ.Studio.{Source, StreamInfo, Watch}
  alias Situ.Studio.Source.History

  @typedoc """
  A pipeline, or a function that finds it again (of one that a supervisor restarts); with a title or without. `{:all,
  find}` is a function that finds several, as `Situ.Cluster.pipelines/0`.
  """
  @type spec ::
          Pipeline.target()
          | (() -> Pipeline.target())
          | {String.t(), spec()}
          | {:all, (() -> [spec()])}

  @doc "The pipelines among `specs` that run now, by their titles."
  @spec running([spec()]) :: [{String.t(), Pipeline.target() | (() -> Pipeline.target())}]
  def running(specs) do
    for spec <- specs,
        one <- each(spec),
        {title, target} <- [titled(one)],
        title != nil,
        do: {title, target}
  end

  # Those of a cluster come and go.
  defp each({:all, find}) when is_function(find, 0), do: find.()
  defp each(spec), do: [spec]

  defp titled({title, target}) when is_binary(title), do: {name(target) && title, target}
  defp titled(target), do: {name(target), target}

  defp name(target) do
    Pipeline.info(Watch.target(target)).pipeline
  rescue
    _ in [Error, ArgumentError, FunctionClauseError] -> nil
  catch
    :exit, _ -> nil
  end

  @doc "A source for the pipeline called `title`, watched under `supervisor`."
  @spec open([spec()], String.t(), Supervisor.supervisor()) ::
          {:ok, Source.t()} | {:error, Error.t()}
  def open(specs, title, supervisor) do
    case List.keyfind(running(specs), title, 0) do
      {_, target} ->
        {:ok, pid} = DynamicSupervisor.start_child(supervisor, {Watch, target})
        {:ok, {__MODULE__, Watch.handle(pid)}}

      nil ->
        {:error, Error.new(:not_running, "no pipeline called #{inspect(title)} runs")}
    end
  end

  @impl true
  def extent(watch) do
    with {:ok, streams, running?} <- Watch.streams(watch),
         {:ok, extent} <- History.extent(watch.history) do
      extent = %{extent | live: running?, version: length(streams)}
      {:ok, if(seen?(watch), do: extent, else: at_clock(extent, Watch.now(watch)))}
    end
  end

  # Before anything was seen the pipeline's clock tells where its times are: a replay's are those of the recording.
  defp seen?(watch), do: :ets.info(watch.history.messages, :size) not in [0, :undefined]
  defp at_clock(extent, now), do: %{extent | from: now, to: now}

  @impl true
  def streams(watch) do
    with {:ok, named, _} <- Watch.streams(watch),
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

  @doc "The pipeline's graph and numbers now, for the page of its graph."
  @spec snapshot(Watch.t()) :: {:ok, Situ.Diagnostics.Snapshot.t()} | {:error, Error.t()}
  def snapshot(watch), do: Watch.snapshot(watch)

  @doc "Where the message of one originating time is now."
  @spec trace(Watch.t(), Situ.Time.t()) :: {:ok, Situ.Diagnostics.Trace.t()} | {:error, Error.t()}
  def trace(watch, time), do: Watch.trace(watch, time)

  @impl true
  def wanted(watch, streams), do: Enum.each(streams, &Watch.want(watch, &1))

  @impl true
  def series(watch, stream, from, to, bin),
    do: wanted(watch, stream, &History.series(&1, stream, from, to, bin))

  @impl true
  def messages(watch, stream, from, to, limit),
    do: wanted(watch, stream, &History.messages(&1, stream, from, to, limit))

  @impl true
  def marks(watch, stream, from, to, limit),
    do: wanted(watch, stream, &History.marks(&1, stream, from, to, limit))

  @impl true
  def sample(watch, stream, from, to, n),
    do: wanted(watch, stream, &History.sample(&1, stream, from, to, n))

  @impl true
  def latest_at(watch, stream, time),
    do: wanted(watch, stream, &History.latest_at(&1, stream, time))

  @impl true
  def next_after(watch, stream, time),
    do: wanted(watch, stream, &History.next_after(&1, stream, time))

  # A stream that cannot be tapped any more, or not at the moment, still has its past.
  defp wanted(watch, stream, read) do
    case Watch.want(watch, stream) do
      :ok ->
        read.(watch.history)

      {:error, %{code: :not_running}} ->
        read.(watch.history)

      {:error, error} ->
        case Watch.streams(watch) do
          {:ok, _, false} -> read.(watch.history)
          _ -> {:error, error}
        end
    end
  end
end
