defmodule Situ.Studio.Comparison do
  @moduledoc false
  # Compares two recordings on one time axis. The second is shifted so that the beginnings, or an
  # event in each, coincide. In an address, `with` names the second recording and `offset` is the
  # shift in ns.
  alias Situ.Error
  alias Situ.Studio.{Catalog, Layout, Int64, Recordings, StreamReader}
  alias Situ.Studio.Recordings.DerivedStreams

  @enforce_keys [:id, :title, :offset, :first, :second]
  defstruct [:id, :title, :offset, :first, :second]

  @typedoc "The second item, the shift of its times, and the extent of both recordings by their own clocks."
  @type t :: %__MODULE__{
          id: String.t(),
          title: String.t(),
          offset: Situ.Time.duration(),
          first: StreamReader.extent(),
          second: StreamReader.extent()
        }

  @doc "Opens an item, together with the item that `params` compares it with, if any."
  @spec open_item(Catalog.id(), term(), map()) ::
          {:ok, Catalog.Item.t(), Situ.Recording.t(), t() | nil} | {:error, Error.t()}
  def open_item(studio, id, %{"with" => other} = params) when is_binary(other) and other != "" do
    with {:ok, item, %{state: %DerivedStreams{recording: first}}} <-
           Catalog.open_source(studio, id),
         {:ok, compared, %{state: %DerivedStreams{recording: second}}} <-
           Catalog.open_source(studio, other),
         {:ok, a} <- StreamReader.fetch_extent(first),
         {:ok, b} <- StreamReader.fetch_extent(second) do
      offset =
        case Int64.parse(params["offset"]) do
          {:ok, offset} -> offset
          :error -> a.from - b.from
        end

      both = Recordings.Comparison.combine_recordings(first, second, offset)

      comparison = %__MODULE__{
        id: other,
        title: compared.title,
        offset: offset,
        first: a,
        second: b
      }

      {:ok, item, DerivedStreams.wrap(both), comparison}
    end
  end

  def open_item(studio, id, _params) do
    with {:ok, item, source} <- Catalog.open_source(studio, id), do: {:ok, item, source, nil}
  end

  @doc "Changes the time offset of a comparison; other recordings are returned unchanged."
  @spec set_offset(Situ.Recording.t(), Situ.Time.duration()) :: Situ.Recording.t()
  def set_offset(%{state: %{recording: %{state: %Recordings.Comparison{} = both}}}, offset),
    do:
      DerivedStreams.wrap(
        Recordings.Comparison.combine_recordings(both.first, both.second, offset)
      )

  def set_offset(source, _offset), do: source

  @doc """
  Adds to each stream of the first recording the stream with the same name of the second: lines and lanes in the same
  panel, images and values in a panel next to it. Streams of the second recording that are already in the layout are
  not added again. `names` contains all streams.

      iex> alias Situ.Studio.{Comparison, Layout}
      iex> {:ok, layout, _} = Layout.add_stream(Layout.new(""), "Level", "line", :plot, "")
      iex> {:ok, layout, _} = Layout.add_stream(layout, "Image", "image", :image, "")
      iex> both = Comparison.add_compared_streams(layout, ["Level", "Image", "Compared.Level", "Compared.Image"])
      iex> for p <- both.panels, do: {p.panel, Enum.map(p.vis, & &1.stream)}
      [{:image, ["Image"]}, {:image, ["Compared.Image"]}, {:plot, ["Level", "Compared.Level"]}]
  """
  @spec add_compared_streams(Layout.t(), Enumerable.t()) :: Layout.t()
  def add_compared_streams(%Layout{} = layout, names) do
    shown =
      for panel <- layout.panels,
          v <- panel.vis,
          into: MapSet.new(),
          do: {v.viz, v.stream, v.path}

    names = MapSet.new(names)

    twins = fn v ->
      Enum.reject(compared_visualizations(v, names), &({&1.viz, &1.stream, &1.path} in shown))
    end

    {panels, vis} = Layout.size_limits()

    Enum.reduce(layout.panels, layout, fn panel, layout ->
      case Enum.flat_map(panel.vis, twins) do
        [] ->
          layout

        # Each stream is followed by its counterpart.
        _ when panel.panel in [:plot, :lanes] ->
          both = Enum.flat_map(panel.vis, &[&1 | twins.(&1)])
          Layout.update_panel(layout, panel.id, &%{&1 | vis: Enum.take(both, vis)})

        seconds when length(layout.panels) < panels ->
          Layout.add_beside(layout, %{panel | vis: seconds}, panel.id)

        _ ->
          layout
      end
    end)
  end

  defp compared_visualizations(vis, names) do
    name = Recordings.Comparison.compared_name(vis.stream)

    if name in names,
      do: [%{vis | stream: name, props: Map.delete(vis.props, "color")}],
      else: []
  end
end
