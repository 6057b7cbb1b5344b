defmodule Situ.Studio.Experiments.DifferencePage do
  @moduledoc false
  # The page of a session at a difference between two sets: the session's images and sound, and below them the outputs
  # and the truth as lanes.
  alias Situ.Dataset
  alias Situ.Experiment.{Difference, DifferenceFiles}
  alias Situ.Studio.{Catalog, Layout, Link, StreamOverview, StreamReader}
  alias Situ.Studio.Datasets.DatasetRef
  alias Situ.Studio.Experiments.DifferencePart
  alias Situ.Studio.Web.Paths

  @prefix DifferencePart.part_name() <> "."
  # A longer session is shown around the first difference, from this time before it to this time after it (ns).
  @before 5_000_000_000
  @later 15_000_000_000

  @doc """
  Prepares the recording of the differences of a set from the baseline in a session, and returns the address of its
  page. `sets` has `set`, `baseline`, `read_only`, and the `metric` that chooses the difference to begin with.
  """
  @spec open_address(
          Catalog.id(),
          {dataset_id :: String.t(), Path.t(), session :: String.t()},
          map()
        ) ::
          {:ok, String.t()} | {:error, Situ.Error.t()}
  def open_address(studio, {dataset_id, file, name}, sets) do
    options = [read_only: sets.read_only]

    with {:ok, dataset} <- Dataset.load(file),
         {:ok, session} <- Dataset.session(dataset, name),
         {:ok, found} <-
           DifferenceFiles.ensure_recording(session, sets.set, sets.baseline, options),
         id = DatasetRef.build_id(dataset_id, [name, DifferencePart.encode_name(found.name)]),
         {:ok, _item, source} <- Catalog.open_source(studio, id),
         {:ok, streams} <- StreamOverview.list_streams(source) do
      first =
        Difference.find_first(found.path, sets.metric["stream"]) ||
          Difference.find_first(found.path, nil)

      params = %{
        edit: Link.encode(build_layout(source, streams)),
        snap: @prefix <> Difference.stream_name()
      }

      {:ok,
       Paths.source_path(id) <>
         "?" <> URI.encode_query(Map.merge(params, time_params(source, first)))}
    end
  end

  defp time_params(_source, nil), do: %{}

  defp time_params(source, first) do
    case StreamReader.fetch_extent(source) do
      {:ok, %{from: from, to: to}} when to - from > 2 * (@before + @later) ->
        start = max(first - @before, from)
        %{at: first, view: "#{start}~#{min(start + @before + @later, to)}"}

      _ ->
        %{at: first}
    end
  end

  @doc """
  Builds the layout: the session's own images and sound as usual, numbers of both outputs and the truth on one axis, a
  lane for each output and the truth, and the differences as the last lanes.
  """
  @spec build_layout(Situ.Recording.t(), [Situ.Studio.StreamInfo.t()]) :: Layout.t()
  def build_layout(source, streams) do
    {own, session} = Enum.split_with(streams, &String.starts_with?(&1.name, @prefix))

    session =
      Enum.filter(
        session,
        &(&1.shape in [:image, :depth, :audio, :signal, :space, :frames, :place])
      )

    shapes = Enum.filter(own, &(&1.shape == :shapes))

    {last, lanes} =
      own
      |> Enum.filter(&(&1.shape == :spans))
      |> Enum.split_with(&(&1.name == @prefix <> Difference.stream_name()))

    (session ++ shapes)
    |> Layout.Auto.build_layout(Layout.ImageLook.detect_looks(source, session))
    |> add_lines(Enum.filter(own, &(&1.shape == :signal)))
    |> add_lanes(Enum.filter(own, &(&1.shape in [:text, :states, :boolean, :state])), "states")
    |> add_lanes(lanes ++ last, "spans")
  end

  # `Set.Level`, `Baseline.Level` and `Truth.Level` share an axis.
  defp add_lines(layout, signals) do
    signals
    |> Enum.group_by(&(&1.name |> String.split(".", parts: 3) |> List.last()))
    |> Enum.sort()
    |> Enum.reduce(layout, fn {_, together}, layout ->
      add_panel(layout, together, "line", :plot)
    end)
  end

  defp add_lanes(layout, streams, viz) do
    {_, most} = Layout.size_limits()
    add_panel(layout, Enum.take(streams, most), viz, :lanes)
  end

  defp add_panel(layout, streams, viz, panel) do
    {layout, _} =
      Enum.reduce(streams, {layout, ""}, fn stream, {layout, id} ->
        viz = if stream.shape == :text, do: "labels", else: viz

        case Layout.add_stream(layout, stream.name, viz, panel, id) do
          {:ok, layout, id} -> {layout, id}
          {:error, _} -> {layout, id}
        end
      end)

    layout
  end
end
