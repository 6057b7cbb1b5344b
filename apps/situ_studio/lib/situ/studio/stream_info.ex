defmodule Situ.Studio.StreamInfo do
  @moduledoc """
  Describes one stream of any source, including its shape, by which visualizers are chosen.

  `shape` is one of `:signal`, `:boolean`, `:state` (atoms), `:text`, `:audio`, `:image`, `:depth`, `:shapes`
  (rectangles and points over images), `:masks` (lists of masks over images), `:bars` (lists of numbers), `:signals`
  (maps of numbers), `:states` (maps of booleans, atoms or strings), `:spans` (time intervals), `:space` (poses,
  clouds, skeletons and so on), `:frames` (`Situ.Transform`s), `:place` (geographic positions) or `:value` (any other
  term).

      iex> Situ.Studio.StreamInfo.shape({:list, Situ.Rect})
      :shapes
      iex> Situ.Studio.StreamInfo.shape({:optional, :float})
      :signal
      iex> Situ.Studio.StreamInfo.shape({:map, :any, :boolean})
      :states
      iex> Situ.Studio.StreamInfo.shape_of(%{"a" => 1.5})
      :signals
  """
  alias Situ.Studio.Draw.{Key, Segments}
  alias Situ.Studio.Scene.Terms
  alias Situ.Studio.Visualizers.{Bars, Shapes, Spans}

  @in_space Terms.shapes()

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
  @spec shapes() :: [shape()]
  def shapes do
    [:signal, :boolean, :state, :text, :audio, :image, :depth, :shapes, :masks, :bars, :signals] ++
      [:states, :spans, :space, :frames, :place, :value]
  end

  @doc """
  Returns the mean rate of `count` messages between two times per second, or `nil` if it is undefined.

      iex> Situ.Studio.StreamInfo.rate(101, 0, 1_000_000_000)
      100.0
  """
  @spec rate(non_neg_integer(), Situ.Time.t() | nil, Situ.Time.t() | nil) :: float() | nil
  def rate(count, first, last) when count > 1 and first != nil and last > first,
    do: (count - 1) * 1.0e9 / (last - first)

  def rate(_, _, _), do: nil

  @doc "Returns the shape of a declared type; for `:any`, `shape_of/1` of a message is more precise."
  @spec shape(Situ.Type.t() | nil) :: shape()
  def shape(type) when type in [:integer, :float, :number], do: :signal
  def shape(:boolean), do: :boolean
  def shape(:atom), do: :state
  def shape({:in, values}), do: if(Enum.all?(values, &is_number/1), do: :signal, else: :state)
  def shape(:string), do: :text
  def shape(Situ.AudioBuffer), do: :audio
  def shape(type) when type in [Situ.Image, Situ.EncodedImage], do: :image
  def shape(Situ.DepthImage), do: :depth
  def shape(type) when type in [Situ.Rect, Situ.Point2], do: :shapes
  def shape({:optional, type}), do: shape(type)

  def shape({:list, type}) do
    case shape(type) do
      :signal -> :bars
      :image -> :masks
      shape when shape in [:shapes, :spans, :space, :frames] -> shape
      _ -> :value
    end
  end

  def shape({:map, _key, type}) do
    case shape(type) do
      :signal -> :signals
      shape when shape in [:boolean, :state, :text] -> :states
      shape when shape in [:spans, :space] -> shape
      _ -> :value
    end
  end

  def shape(Situ.Transform), do: :frames
  def shape(Situ.GeoPoint), do: :place

  def shape(type) when is_atom(type) and type not in [nil, :any] do
    cond do
      type in @in_space -> :space
      Spans.struct?(type) -> :spans
      true -> :value
    end
  end

  def shape(_), do: :value

  @doc """
  Returns the shape of a type given as text in the format of `Situ.Type.to_string/1`.

      iex> Situ.Studio.StreamInfo.shape_of_text("list of Situ.Rect")
      :shapes
      iex> Situ.Studio.StreamInfo.shape_of_text("map of any to float or nil")
      :signals
  """
  @spec shape_of_text(String.t()) :: shape()
  def shape_of_text(text), do: text |> read() |> shape()

  @simple ~w(integer float number boolean atom string)

  # Parses only the parts of a type that determine its shape. A name is converted only if its atom already exists.
  defp read("list of " <> type), do: {:list, read(type)}
  defp read("one of :" <> _), do: :atom
  defp read(text) when text in @simple, do: String.to_existing_atom(text)

  defp read("map of " <> rest) do
    case String.split(rest, " to ", parts: 2) do
      [_, value] -> {:map, :any, read(value)}
      _ -> :any
    end
  end

  defp read(text) do
    case String.split(text, " or nil", parts: 2) do
      [type, ""] when type != "" -> {:optional, read(type)}
      _ -> String.to_existing_atom("Elixir." <> text)
    end
  rescue
    ArgumentError -> :any
  end

  @doc """
  Refines the shape with some messages: infers the shape if it is `:value`, and the lanes of maps and intervals.

      iex> Situ.Studio.StreamInfo.look_inside(:value, [%{}, %{left: true}, %{right: false}])
      {:states, ["left", "right"]}
  """
  @spec look_inside(shape(), [term()]) :: {shape(), [String.t()]}
  def look_inside(:value, data) do
    case data |> Enum.map(&shape_of/1) |> Enum.find(:value, &(&1 != :value)) do
      :value -> {:value, []}
      shape -> look_inside(shape, data)
    end
  end

  def look_inside(:states, data),
    do: {:states, data |> Enum.flat_map(&Segments.lanes/1) |> Enum.uniq() |> Key.sort()}

  def look_inside(:spans, data) do
    lanes = for value <- data, {_, _, _, _, lane} <- Spans.of(value, 0), lane != "", do: lane
    {:spans, lanes |> Enum.uniq() |> Key.sort()}
  end

  def look_inside(shape, _), do: {shape, []}

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
    if match?({:ok, _}, Situ.GeoPoint.of(map)), do: :place, else: shape_of_values(map)
  end

  def shape_of(data), do: composite(data)

  defp shape_of_values(map) do
    case map |> Map.values() |> Enum.reject(&is_nil/1) |> Enum.map(&shape_of/1) |> Enum.uniq() do
      [:signal] -> :signals
      [shape] when shape in [:boolean, :state, :text] -> :states
      [:spans] -> :spans
      _ -> composite(map)
    end
  end

  defp composite(data) do
    cond do
      Bars.of(data) != [] -> :bars
      Shapes.any?(data) -> :shapes
      Terms.any?(data) -> :space
      Spans.of(data, 0) != [] -> :spans
      Bars.series(data) != [] -> :bars
      true -> :value
    end
  end
end
