defmodule Situ.Studio.Web.StreamFacts do
  @moduledoc false
  # Facts about the streams of a page's source: their shapes, lanes, colors, and the times at which they begin and end.
  import Situ.Live.Socket, only: [assign: 2]

  alias Situ.Live.Socket

  alias Situ.Studio.{
    StreamColors,
    Coverage,
    StreamInfo,
    Visualizer,
    Visualizers,
    StreamOverview,
    StreamReader
  }

  alias Situ.Studio.Web.{DerivedStreams, SourceList}

  @doc "Loads the facts about all streams of the page's source, including derived streams."
  @spec load(Socket.t()) :: Socket.t()
  def load(socket) do
    streams =
      case StreamOverview.list_streams(socket.assigns.source) do
        {:ok, streams} -> streams ++ DerivedStreams.list_infos(socket.assigns)
        {:error, _} -> socket.assigns[:infos] || []
      end

    names = streams |> Enum.map(& &1.name) |> Enum.take(2_000)

    assign(socket,
      infos: streams,
      shapes: Map.new(streams, &{&1.name, &1.shape}),
      colors: StreamColors.rank_streams(Enum.map(streams, & &1.name)),
      lanes: lane_counts(streams, socket.assigns.seen_lanes),
      coverage: build_coverage(streams, socket.assigns.source),
      names: Situ.JSON.encode(Enum.map(names, &printable_name/1)),
      sources: SourceList.list_sources(socket.assigns)
    )
  end

  defp build_coverage(streams, source) do
    case StreamReader.fetch_extent(source) do
      {:ok, extent} -> Coverage.find_partial_streams(streams, extent)
      {:error, _} -> %{}
    end
  end

  @doc "Returns the lane count of each stream: the larger of the count in its facts and the count the page has seen."
  @spec lane_counts([StreamInfo.t()], map()) :: map()
  def lane_counts(streams, seen) do
    known = for %{keys: [_ | _] = keys} = s <- streams, into: %{}, do: {s.name, length(keys)}
    Map.merge(known, seen, fn _, a, b -> max(a, b) end)
  end

  defp printable_name(name), do: if(String.valid?(name), do: name, else: inspect(name))

  @doc "Returns the visualizers of each shape as JSON, for the page's menus."
  @spec encode_visualizers([Visualizer.given()]) :: String.t()
  def encode_visualizers(extra) do
    StreamInfo.list_shapes()
    |> Map.new(&{&1, for(v <- Visualizers.for_shape(&1, extra), do: [v.id, v.title, v.panel])})
    |> Situ.JSON.encode()
  end

  @doc "Returns the start time of the data, to which the page's relative times refer."
  @spec data_start(map()) :: Situ.Time.t()
  def data_start(assigns) do
    case StreamReader.fetch_extent(assigns.source) do
      {:ok, extent} -> extent.from
      {:error, _} -> 0
    end
  end
end
