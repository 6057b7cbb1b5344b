defmodule Situ.Studio.StreamInfo do
  @moduledoc """
  What the studio knows about one stream, wherever it comes from, and of which kind of picture it is.

  `shape` is the noun a visualizer is chosen by: `:signal`, `:boolean`, `:state` (atoms), `:text`, `:audio`, `:image`,
  `:depth`, `:shapes` (rectangles and points over pictures), `:bars` (lists or maps of numbers) or `:value` (anything).

      iex> Situ.Studio.StreamInfo.shape({:list, Situ.Rect})
      :shapes
      iex> Situ.Studio.StreamInfo.shape({:optional, :float})
      :signal
      iex> Situ.Studio.StreamInfo.shape_of(%{"a" => 1.5})
      :bars
  """
  @enforce_keys [:name, :shape]
  defstruct [:name, :shape, :type, :first, :last, count: 0, bytes: 0, latency: nil, details: []]

  @type shape ::
          :signal
          | :boolean
          | :state
          | :text
          | :audio
          | :image
          | :depth
          | :shapes
          | :bars
          | :value
  @type t :: %__MODULE__{
          name: String.t(),
          shape: shape(),
          type: String.t() | nil,
          first: Situ.Time.t() | nil,
          last: Situ.Time.t() | nil,
          count: non_neg_integer(),
          bytes: non_neg_integer(),
          latency: number() | nil,
          details: [{String.t(), String.t()}]
        }

  @doc "The shape of a declared type; `:any` is known better by `shape_of/1`."
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
      :shapes -> :shapes
      _ -> :value
    end
  end

  def shape({:map, _key, type}), do: if(shape(type) == :signal, do: :bars, else: :value)
  def shape(_), do: :value

  @texts for type <- [
               :integer,
               :float,
               :number,
               :boolean,
               :atom,
               :string,
               Situ.AudioBuffer,
               Situ.Image,
               Situ.EncodedImage,
               Situ.DepthImage,
               Situ.Rect,
               {:list, Situ.Rect},
               {:list, Situ.Point2},
               {:list, :float},
               {:map, :string, :float}
             ],
             into: %{},
             do: {Situ.Type.to_string(type), type}

  @doc """
  The shape of a type known by its text only, as `Situ.Type.to_string/1` writes it.

      iex> Situ.Studio.StreamInfo.shape_of_text("list of Situ.Rect")
      :shapes
  """
  @spec shape_of_text(String.t()) :: shape()
  def shape_of_text(text), do: @texts |> Map.get(text) |> shape()

  @doc "The shape of a message's data."
  @spec shape_of(term()) :: shape()
  def shape_of(data) when is_number(data), do: :signal
  def shape_of(data) when is_boolean(data), do: :boolean
  def shape_of(data) when is_atom(data) and not is_nil(data), do: :state
  def shape_of(data) when is_binary(data), do: if(String.valid?(data), do: :text, else: :value)
  def shape_of(%Situ.AudioBuffer{}), do: :audio
  def shape_of(%Situ.Image{}), do: :image
  def shape_of(%Situ.EncodedImage{}), do: :image
  def shape_of(%Situ.DepthImage{}), do: :depth

  def shape_of(data) do
    cond do
      Situ.Studio.Draw.Bars.of(data) != [] -> :bars
      Situ.Studio.Draw.Shapes.any?(data) -> :shapes
      true -> :value
    end
  end
end
