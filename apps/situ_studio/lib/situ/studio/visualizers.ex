defmodule Situ.Studio.Visualizers do
  @moduledoc false
  # Lists the visualizers and selects the visualizers that accept a stream; the first is the
  # default. To add visualizers, pass their modules to `Situ.Studio` as `visualizers: [MyModule]`,
  # see `Situ.Studio.Visualizer`.
  alias Situ.Studio.{StreamInfo, Visualizer}

  alias Situ.Studio.Visualizers.{
    Bars,
    Depth,
    Frames,
    GeoMap,
    Image,
    Labels,
    Latency,
    Line,
    Lines,
    Log,
    Masks,
    Messages,
    Shapes,
    Space,
    Spans,
    Spectrogram,
    States,
    Table,
    Text,
    Trail,
    Value,
    Waveform,
    XY
  }

  @modules [Waveform, Lines, States, Spans, Labels, Line, Image, Depth, Shapes, Masks, Bars] ++
             [Space, Trail, Frames, GeoMap, XY, Spectrogram, Text, Value, Table, Log] ++
             [Messages, Latency]

  @doc "Returns all visualizers; the `extra` modules come first."
  @spec all([Visualizer.definition()]) :: [Visualizer.t()]
  def all(extra \\ []), do: Enum.map(extra ++ @modules, &Visualizer.to_visualizer/1)

  @doc """
  Returns the visualizers for a stream of this shape, the default first.

      iex> for v <- Situ.Studio.Visualizers.for_shape(:boolean), do: v.id
      ["states", "line", "value", "table", "log", "messages", "latency"]
  """
  @spec for_shape(StreamInfo.shape(), [Visualizer.definition()]) :: [Visualizer.t()]
  def for_shape(shape, extra \\ []),
    do: Enum.filter(all(extra), &(&1.shapes == :any or shape in &1.shapes))

  @doc "Returns the visualizer `id` if it accepts this shape."
  @spec fetch(String.t(), StreamInfo.shape(), [Visualizer.definition()]) ::
          {:ok, Visualizer.t()} | :error
  def fetch(id, shape, extra \\ []), do: shape |> for_shape(extra) |> fetch_from_list(id)

  @doc "Returns the visualizer of a layout entry; a part of a message (a path) may use any visualizer."
  @spec fetch_for_path(String.t(), String.t(), StreamInfo.shape(), [Visualizer.definition()]) ::
          {:ok, Visualizer.t()} | :error
  def fetch_for_path(id, "", shape, extra), do: fetch(id, shape, extra)
  def fetch_for_path(id, _path, _shape, extra), do: fetch_from_list(all(extra), id)

  @doc "Returns the built-in or `extra` visualizer `id`."
  @spec fetch_by_id(String.t(), [Visualizer.definition()]) :: {:ok, Visualizer.t()} | :error
  def fetch_by_id(id, extra), do: fetch_from_list(all(extra), id)

  defp fetch_from_list(visualizers, id) do
    case Enum.find(visualizers, &(&1.id == id)) do
      nil -> :error
      visualizer -> {:ok, visualizer}
    end
  end
end
