defmodule Situ.Studio.Visualizers.Masks do
  @moduledoc false
  # Draws masks over images. The masks are an image whose values are class numbers
  # (`Situ.Infer.Segmentation`), or a list of `:gray8` images, each bright where the object in its
  # box is (`Situ.Infer.ObjectDetector`). The boxes come with the masks as pairs (`{rect, mask}`),
  # or from the stream that has the same number of `Situ.Rect`s at the same time. The page
  # receives masks as runs: a value and its number of repetitions, starting at the upper left
  # corner.
  @behaviour Situ.Studio.Visualizer

  alias Situ.{Image, Rect}
  alias Situ.Studio.{Frame, Visualizer, StreamOverview, StreamReader}
  alias Situ.Studio.Visualizers.SharedOptions

  # More masks in one image cannot be distinguished, and larger ones add no detail.
  @most 200
  @pixels 4_194_304
  @fits [
    {"pad", "the square around the image"},
    {"crop", "the square in its middle"},
    {"whole", "the whole image"}
  ]

  @typedoc "An image of class numbers, or objects with their boxes."
  @type found :: {:classes, Image.t()} | {:objects, [{Rect.t(), Image.t()}]}

  @impl true
  def about do
    options =
      SharedOptions.visible() ++
        [
          opacity: [type: {:range, 5, 100}, title: "Opacity in %", default: 45],
          labels: [type: :boolean, title: "Labels", default: true],
          fit: [type: {:in, @fits}, title: "Classes cover", default: "pad"]
        ] ++ SharedOptions.near_cursor()

    %Visualizer{
      id: "masks",
      title: "Masks over images",
      panel: :image,
      shapes: [:masks, :image],
      options: options,
      asks: SharedOptions.requested_keys()
    }
  end

  @impl true
  def instant(channel, data, message, %{source: source, spec: %{stream: stream}}) do
    with {:ok, found} <- fetch_masks(data, source, stream, message.originating_time),
         do: Frame.json(channel, message.originating_time, masks_json(found))
  end

  @doc "Fetches the classes in a message's data, or the objects with their boxes, or the reason why there are none."
  @spec fetch_masks(term(), Situ.Recording.t(), String.t(), Situ.Time.t()) ::
          {:ok, found()} | {:error, String.t()}
  def fetch_masks(%Image{} = image, _source, _stream, _time) do
    with {:ok, image} <- validate_gray(image), do: {:ok, {:classes, image}}
  end

  def fetch_masks([{%Rect{}, %Image{}} | _] = pairs, _source, _stream, _time),
    do: boxed_objects(pairs)

  def fetch_masks([%Image{} | _] = masks, source, stream, time) do
    case find_rects(source, stream, time, length(masks)) do
      {:ok, rects} -> boxed_objects(Enum.zip(rects, masks))
      :none -> {:error, "no stream has as many rectangles at the same time"}
    end
  end

  def fetch_masks([], _source, _stream, _time), do: {:ok, {:objects, []}}
  def fetch_masks(_, _, _, _), do: {:error, "this message does not contain masks"}

  defp boxed_objects(pairs) do
    objects =
      for {%Rect{} = rect, %Image{} = image} <- Enum.take(pairs, @most),
          {:ok, image} <- [validate_gray(image)],
          do: {rect, image}

    {:ok, {:objects, objects}}
  end

  defp masks_json({:classes, image}), do: %{"classes" => encode_runs(image)}

  defp masks_json({:objects, objects}) do
    masks =
      for {r, image} <- objects do
        Map.merge(encode_runs(image), %{
          "box" => [r.x, r.y, r.width, r.height],
          "label" => r.label && to_string(r.label),
          "score" => r.score,
          "id" => if(is_integer(r.id), do: r.id)
        })
      end

    %{"masks" => masks}
  end

  defp validate_gray(%Image{width: w, height: h}) when w * h > @pixels,
    do: {:error, "a mask of #{w} x #{h} is too large to draw"}

  defp validate_gray(%Image{format: :gray8} = image) do
    case Image.validate(image) do
      {:ok, image} -> {:ok, image}
      {:error, error} -> {:error, error.what}
    end
  end

  defp validate_gray(%Image{format: format}),
    do: {:error, "masks must be :gray8 images, not #{format}"}

  # Tries the streams with the most similar names first, because the outputs of a detector share a prefix.
  defp find_rects(source, stream, time, count) do
    with {:ok, infos} <- StreamOverview.list_streams(source) do
      infos
      |> Enum.filter(&(&1.shape == :shapes))
      |> Enum.sort_by(&(-common_prefix_size(&1.name, stream)))
      |> Enum.find_value(:none, &rects_at(source, &1.name, time, count))
    else
      _ -> :none
    end
  end

  defp rects_at(source, stream, time, count) do
    case StreamReader.latest_at(source, stream, time) do
      {:ok, %{originating_time: ^time, data: rects}}
      when is_list(rects) and length(rects) == count ->
        if Enum.all?(rects, &is_struct(&1, Rect)), do: {:ok, rects}

      _ ->
        nil
    end
  end

  defp common_prefix_size(a, b), do: :binary.longest_common_prefix([a, b])

  @doc """
  Encodes a `:gray8` image as runs.

      iex> image = Situ.Image.new!(width: 2, height: 2, format: :gray8, data: <<0, 7, 7, 7>>)
      iex> Situ.Studio.Visualizers.Masks.encode_runs(image)
      %{"width" => 2, "height" => 2, "runs" => [0, 1, 7, 3]}
  """
  @spec encode_runs(Image.t()) :: map()
  def encode_runs(%Image{width: w, height: h} = image),
    do: %{"width" => w, "height" => h, "runs" => image |> Image.pixel_bytes() |> collect_runs([])}

  defp collect_runs(<<>>, acc), do: Enum.reverse(acc)
  defp collect_runs(<<v, rest::binary>>, acc), do: count_run(rest, v, 1, acc)

  defp count_run(<<v, rest::binary>>, v, n, acc), do: count_run(rest, v, n + 1, acc)
  defp count_run(rest, v, n, acc), do: collect_runs(rest, [n, v | acc])
end
