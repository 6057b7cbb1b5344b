defmodule Situ.Studio.Visualizers.Masks do
  @moduledoc """
  Masks over pictures: a picture whose values are the numbers of classes (`Situ.Infer.Segmentation`), or a list of
  `:gray8` pictures, each bright where the object in its box is (`Situ.Infer.ObjectDetector`). The boxes come with the
  masks as pairs (`{rect, mask}`), or from the stream of `Situ.Rect`s that has as many at the same time. They go to the
  page as runs: a value, and how often it follows itself, from the upper left corner on.

      iex> image = Situ.Image.new!(width: 2, height: 2, format: :gray8, data: <<0, 7, 7, 7>>)
      iex> Situ.Studio.Visualizers.Masks.runs(image)
      %{"width" => 2, "height" => 2, "runs" => [0, 1, 7, 3]}
  """
  @behaviour Situ.Studio.Visualizer

  alias Situ.{Image, Rect}
  alias Situ.Studio.{Frame, Source, Visualizer}
  alias Situ.Studio.Visualizers.Option

  # More in one picture cannot be told apart, and larger ones say no more.
  @most 200
  @pixels 4_194_304
  @fits [
    {"pad", "the square around the picture"},
    {"crop", "the square in its middle"},
    {"whole", "the whole picture"}
  ]

  @impl true
  def about do
    options =
      Option.visible() ++
        [
          opacity: [type: {:range, 5, 100}, title: "Opacity in %", default: 45],
          labels: [type: :boolean, title: "Labels", default: true],
          fit: [type: {:in, @fits}, title: "Classes cover", default: "pad"]
        ]

    %Visualizer{
      id: "masks",
      title: "Masks over pictures",
      panel: :image,
      shapes: [:masks, :image],
      options: options
    }
  end

  @impl true
  def instant(channel, data, message, context) do
    with {:ok, masks} <- of(data, message, context),
         do: Frame.json(channel, message.originating_time, masks)
  end

  defp of(%Image{} = image, _message, _context) do
    with {:ok, image} <- gray(image), do: {:ok, %{"classes" => runs(image)}}
  end

  defp of([{%Rect{}, %Image{}} | _] = pairs, _message, _context), do: boxes(pairs)

  defp of([%Image{} | _] = masks, message, context) do
    case rects(context, message.originating_time, length(masks)) do
      {:ok, rects} -> boxes(Enum.zip(rects, masks))
      :none -> {:error, "there is no stream with as many rectangles at the same time"}
    end
  end

  defp of([], _message, _context), do: {:ok, %{"masks" => []}}
  defp of(_, _, _), do: {:error, "this message holds no masks"}

  defp boxes(pairs) do
    masks =
      for {%Rect{} = r, %Image{} = image} <- Enum.take(pairs, @most),
          {:ok, image} <- [gray(image)] do
        Map.merge(runs(image), %{
          "box" => [r.x, r.y, r.width, r.height],
          "label" => r.label && to_string(r.label),
          "score" => r.score,
          "id" => if(is_integer(r.id), do: r.id)
        })
      end

    {:ok, %{"masks" => masks}}
  end

  defp gray(%Image{width: w, height: h}) when w * h > @pixels,
    do: {:error, "a mask of #{w} x #{h} is larger than any that is drawn"}

  defp gray(%Image{format: :gray8} = image) do
    case Image.validate(image) do
      {:ok, image} -> {:ok, image}
      {:error, error} -> {:error, error.what}
    end
  end

  defp gray(%Image{format: format}), do: {:error, "masks are :gray8 pictures, not #{format}"}

  # The nearest by its name first: a detector's outputs share the beginning of theirs.
  defp rects(%{source: source, spec: %{stream: stream}}, time, count) do
    with {:ok, infos} <- Source.call(source, :streams, []) do
      infos
      |> Enum.filter(&(&1.shape == :shapes))
      |> Enum.sort_by(&(-shared(&1.name, stream)))
      |> Enum.find_value(:none, &at(source, &1.name, time, count))
    else
      _ -> :none
    end
  end

  defp at(source, stream, time, count) do
    case Source.call(source, :latest_at, [stream, time]) do
      {:ok, %{originating_time: ^time, data: rects}}
      when is_list(rects) and length(rects) == count ->
        if Enum.all?(rects, &is_struct(&1, Rect)), do: {:ok, rects}

      _ ->
        nil
    end
  end

  defp shared(a, b), do: :binary.longest_common_prefix([a, b])

  @doc "A `:gray8` picture as runs."
  @spec runs(Image.t()) :: map()
  def runs(%Image{width: w, height: h} = image),
    do: %{"width" => w, "height" => h, "runs" => image |> Image.pixels() |> runs([])}

  defp runs(<<>>, acc), do: Enum.reverse(acc)
  defp runs(<<v, rest::binary>>, acc), do: run(rest, v, 1, acc)

  defp run(<<v, rest::binary>>, v, n, acc), do: run(rest, v, n + 1, acc)
  defp run(rest, v, n, acc), do: runs(rest, [n, v | acc])
end
