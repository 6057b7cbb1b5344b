defmodule Situ.Studio.Layout.ImageLook do
  @moduledoc false
  # Determines the look of a stream's images from one of them: their shape, and whether their
  # values are class numbers (labels of a segmentation) rather than shades of grey. Drawn in grey,
  # class numbers would be nearly black.
  alias Situ.{EncodedImage, Image, ImageOps}
  alias Situ.Studio.{StreamInfo, StreamReader}

  @enforce_keys [:width, :height]
  defstruct [:width, :height, classes: false]

  @type t :: %__MODULE__{width: pos_integer(), height: pos_integer(), classes: boolean()}

  # The maximum number of streams to examine.
  @most 6
  # Class numbers are small, and neighbouring pixels mostly have the same class, whereas a dark image has noise.
  @classes 64
  @same 0.85
  @pixels 4_194_304

  @doc "Determines the looks of a source's image streams, by stream name. Streams that cannot be read are left out."
  @spec detect_looks(Situ.Recording.t(), [StreamInfo.t()]) :: %{optional(String.t()) => t()}
  def detect_looks(source, streams) do
    pictures = for %{shape: :image, first: first} = s <- streams, first != nil, do: s

    for s <- Enum.take(pictures, @most),
        {:ok, message} <- [StreamReader.latest_at(source, s.name, s.first)],
        %__MODULE__{} = look <- [detect_look(message.data)],
        into: %{},
        do: {s.name, look}
  end

  @doc """
  Determines the look of one image. Returns `nil` for anything else.

      iex> picture = Situ.Image.new_filled(400, 100, :rgb24, [1, 2, 3])
      iex> look = Situ.Studio.Layout.ImageLook.detect_look(picture)
      iex> {look.classes, Situ.Studio.Layout.ImageLook.ratio(look)}
      {false, 4.0}
      iex> labels = Situ.Image.new!(width: 4, height: 2, format: :gray8, data: <<0, 0, 0, 0, 3, 3, 3, 3>>)
      iex> Situ.Studio.Layout.ImageLook.detect_look(labels).classes
      true
  """
  @spec detect_look(term()) :: t() | nil
  def detect_look(%Image{width: w, height: h} = image),
    do: build_look(w, h, class_numbers?(image))

  # The images of some file formats have no size until they are decoded.
  def detect_look(%EncodedImage{width: 0} = encoded) do
    with {:ok, %{width: w, height: h}} <- ImageOps.parse(encoded),
         do: build_look(w, h, false),
         else: (_ -> nil)
  end

  def detect_look(%EncodedImage{width: w, height: h}), do: build_look(w, h, false)
  def detect_look(_), do: nil

  @doc "Returns the ratio of width to height."
  @spec ratio(t()) :: float()
  def ratio(%__MODULE__{width: w, height: h}), do: w / h

  defp build_look(w, h, classes) when is_integer(w) and is_integer(h) and w > 0 and h > 0,
    do: %__MODULE__{width: w, height: h, classes: classes}

  defp build_look(_, _, _), do: nil

  defp class_numbers?(%Image{format: :gray8, width: w, height: h} = image)
       when w * h <= @pixels do
    with {:ok, image} <- Image.validate(image),
         <<first, rest::binary>> <- Image.pixel_bytes(image),
         {:ok, same} when same < byte_size(rest) <- count_equal_neighbours(rest, first, 0) do
      same >= @same * byte_size(rest)
    else
      _ -> false
    end
  end

  defp class_numbers?(_), do: false

  # Counts the pixels that equal their predecessor, and stops at a value that cannot be a class number.
  defp count_equal_neighbours(_, v, _) when v >= @classes, do: :no

  defp count_equal_neighbours(<<v, rest::binary>>, v, same),
    do: count_equal_neighbours(rest, v, same + 1)

  defp count_equal_neighbours(<<v, rest::binary>>, _, same),
    do: count_equal_neighbours(rest, v, same)

  defp count_equal_neighbours(<<>>, _, same), do: {:ok, same}
end
