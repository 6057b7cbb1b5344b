defmodule Situ.Studio.StreamInfo do
  @moduledoc false
  # Describes one stream of any recording for a page, including its shape, by which visualizers
  # are chosen. `Situ.Studio.Visualizer` lists the shapes.
  alias Situ.Studio.Draw.{Key, Segments}
  alias Situ.Studio.Scene.TermItems
  alias Situ.Studio.Visualizers.{Bars, Shapes, Spans}

  @in_space TermItems.spatial_structs()

  @enforce_keys [:name, :shape]
  defstruct [
    :name,
    :shape,
    :type,
    :first,
    :last,
    :path,
    count: 0,
    bytes: 0,
    latency: nil,
    rate: nil,
    keys: [],
    details: []
  ]

  @type shape ::
          :signal
          | :boolean
          | :state
          | :text
          | :audio
          | :image
          | :depth
          | :shapes
          | :masks
          | :bars
          | :signals
          | :states
          | :spans
          | :space
          | :frames
          | :place
          | :value
  @typedoc """
  `keys` contains the known lanes of a stream of maps, so that a panel has room for them from the start. `path` is the
  path of the recording that contains the stream, if it is on this machine's disk.
  """
  @type t :: %__MODULE__{
          name: String.t(),
          shape: shape(),
          type: String.t() | nil,
          first: Situ.Time.t() | nil,
          last: Situ.Time.t() | nil,
          path: Path.t() | nil,
          count: non_neg_integer(),
          bytes: non_neg_integer(),
          latency: number() | nil,
          rate: float() | nil,
          keys: [String.t()],
          details: [{String.t(), String.t() | {:time, Situ.Time.t()}}]
        }

  @doc "Returns all shapes."
  @spec list_shapes() :: [shape()]
  def list_shapes do
    [:signal, :boolean, :state, :text, :audio, :image, :depth, :shapes, :masks, :bars, :signals] ++
      [:states, :spans, :space, :frames, :place, :value]
  end

  @doc """
  Returns the mean rate of `count` messages between two times per second, or `nil` if it is undefined.

      iex> Situ.Studio.StreamInfo.mean_rate(101, 0, 1_000_000_000)
      100.0
  """
  @spec mean_rate(non_neg_integer(), Situ.Time.t() | nil, Situ.Time.t() | nil) :: float() | nil
  def mean_rate(count, first, last) when count > 1 and first != nil and last > first,
    do: (count - 1) * 1.0e9 / (last - first)

  def mean_rate(_, _, _), do: nil

  @doc """
  Returns the shape of a declared type; for `:any`, `shape_of/1` of a message is more precise.

      iex> Situ.Studio.StreamInfo.shape_of_type({:list, Situ.Rect})
      :shapes
      iex> Situ.Studio.StreamInfo.shape_of_type({:optional, :float})
      :signal
      iex> Situ.Studio.StreamInfo.shape_of_type({:map, :any, :boolean})
      :states
      iex> Situ.Studio.StreamInfo.shape_of(%{"a" => 1.5})
      :signals
  """
  @spec shape_of_type(Situ.Type.t() | nil) :: shape()
  def shape_of_type(type) when type in [:integer, :float, :number], do: :signal
  def shape_of_type(:boolean), do: :boolean
  def shape_of_type(:atom), do: :state

  def shape_of_type({:in, values}),
    do: if(Enum.all?(values, &is_number/1), do: :signal, else: :state)

  def shape_of_type(:string), do: :text
  def shape_of_type(Situ.AudioBuffer), do: :audio
  def shape_of_type(type) when type in [Situ.Image, Situ.EncodedImage], do: :image
  def shape_of_type(Situ.DepthImage), do: :depth
  def shape_of_type(type) when type in [Situ.Rect, Situ.Point2], do: :shapes
  def shape_of_type({:optional, type}), do: shape_of_type(type)

  def shape_of_type({:list, type}) do
    case shape_of_type(type) do
      :signal -> :bars
      :image -> :masks
      shape when shape in [:shapes, :spans, :space, :frames] -> shape
      _ -> :value
    end
  end

  def shape_of_type({:map, _key, type}) do
    case shape_of_type(type) do
      :signal -> :signals
      shape when shape in [:boolean, :state, :text] -> :states
      shape when shape in [:spans, :space] -> shape
      _ -> :value
    end
  end

  def shape_of_type(Situ.Transform), do: :frames
  def shape_of_type(Situ.GeoPoint), do: :place
  def shape_of_type(Situ.Annotation), do: :spans

  def shape_of_type(type) when is_atom(type) and type not in [nil, :any] do
    cond do
      type in @in_space -> :space
      Spans.interval_struct?(type) -> :spans
      true -> :value
    end
  end

  def shape_of_type(_), do: :value

  @doc """
  Returns the shape of a type given as text in the format of `Situ.Type.to_string/1`.

      iex> Situ.Studio.StreamInfo.shape_of_text("list of Situ.Rect")
      :shapes
      iex> Situ.Studio.StreamInfo.shape_of_text("map of any to float or nil")
      :signals
  """
  @spec shape_of_text(String.t()) :: shape()
  def shape_of_text(text), do: text |> parse_type() |> shape_of_type()

  @simple ~w(integer float number boolean atom string)

  @doc """
  Parses the parts of a type that determine its shape. A name is converted only if its atom already exists.
  """
  @spec parse_type(String.t()) :: Situ.Type.t()
  def parse_type("list of " <> type), do: {:list, parse_type(type)}
  def parse_type("one of :" <> _), do: :atom
  def parse_type(text) when text in @simple, do: String.to_existing_atom(text)

  def parse_type("map of " <> rest) do
    case String.split(rest, " to ", parts: 2) do
      [_, value] -> {:map, :any, parse_type(value)}
      _ -> :any
    end
  end

  def parse_type(text) do
    case String.split(text, " or nil", parts: 2) do
      [type, ""] when type != "" -> {:optional, parse_type(type)}
      _ -> String.to_existing_atom("Elixir." <> text)
    end
  rescue
    ArgumentError -> :any
  end

  @doc """
  Refines the shape with some messages: infers the shape if it is `:value`, and the lanes of maps and intervals.

      iex> Situ.Studio.StreamInfo.refine_shape(:value, [%{}, %{left: true}, %{right: false}])
      {:states, ["left", "right"]}
  """
  @spec refine_shape(shape(), [term()]) :: {shape(), [String.t()]}
  def refine_shape(:value, data) do
    case data |> Enum.map(&shape_of/1) |> Enum.find(:value, &(&1 != :value)) do
      :value -> {:value, []}
      shape -> refine_shape(shape, data)
    end
  end

  def refine_shape(:states, data),
    do: {:states, data |> Enum.flat_map(&Segments.lane_names/1) |> Enum.uniq() |> Key.sort_keys()}

  def refine_shape(:spans, data) do
    lanes =
      for value <- data, {_, _, _, _, lane} <- Spans.find_spans(value, 0), lane != "", do: lane

    {:spans, lanes |> Enum.uniq() |> Key.sort_keys()}
  end

  def refine_shape(shape, _), do: {shape, []}

  @doc "Returns the shape of a message's data."
  @spec shape_of(term()) :: shape()
  def shape_of(data) when is_number(data), do: :signal
  def shape_of(data) when is_boolean(data), do: :boolean
  def shape_of(data) when is_atom(data) and not is_nil(data), do: :state
  def shape_of(data) when is_binary(data), do: if(String.valid?(data), do: :text, else: :value)
  def shape_of(%Situ.AudioBuffer{}), do: :audio
  def shape_of(%Situ.Image{}), do: :image
  def shape_of(%Situ.EncodedImage{}), do: :image
  def shape_of(%Situ.DepthImage{}), do: :depth
  def shape_of(%Situ.Transform{}), do: :frames
  def shape_of(%Situ.GeoPoint{}), do: :place
  def shape_of([%Situ.Transform{} | _]), do: :frames
  def shape_of([%Situ.Image{} | _]), do: :masks
  def shape_of([{%Situ.Rect{}, %Situ.Image{}} | _]), do: :masks

  def shape_of(map) when is_map(map) and not is_struct(map) and map_size(map) > 0 do
    if match?({:ok, _}, Situ.GeoPoint.from_data(map)), do: :place, else: shape_of_values(map)
  end

  def shape_of(data), do: shape_of_composite(data)

  defp shape_of_values(map) do
    case map |> Map.values() |> Enum.reject(&is_nil/1) |> Enum.map(&shape_of/1) |> Enum.uniq() do
      [:signal] -> :signals
      [shape] when shape in [:boolean, :state, :text] -> :states
      [:spans] -> :spans
      _ -> shape_of_composite(map)
    end
  end

  defp shape_of_composite(data) do
    cond do
      Bars.bar_rows(data) != [] -> :bars
      Shapes.any?(data) -> :shapes
      TermItems.any?(data) -> :space
      Spans.find_spans(data, 0) != [] -> :spans
      Bars.named_series(data) != [] -> :bars
      true -> :value
    end
  end
end
