defmodule Situ.Studio.Thumbnail do
  @moduledoc false
  # Renders a thumbnail of a recording for lists: an image from its middle, or a plot of its first
  # signal.
  alias Situ.{Image, ImageOps}
  alias Situ.Studio.{Draw, StreamOverview, StreamReader}

  @width 160
  @height 90
  @bins 160

  @doc "Returns the media type and the bytes, or `:none` if the recording has no image and no signal."
  @spec render_thumbnail(Situ.Recording.t()) :: {:ok, String.t(), iodata()} | :none
  def render_thumbnail(source) do
    with {:ok, streams} <- StreamOverview.list_streams(source),
         {:ok, extent} <- StreamReader.fetch_extent(source) do
      middle = div(extent.from + extent.to, 2)

      image_thumbnail(source, streams_with_shape(streams, [:image]), middle) ||
        signal_thumbnail(source, streams_with_shape(streams, [:audio, :signal]), extent) || :none
    else
      {:error, _} -> :none
    end
  end

  @doc "Returns the SVG image of a recording without a thumbnail: a dashed line."
  @spec empty_svg() :: String.t()
  def empty_svg do
    ~s(<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 #{@width} #{@height}">) <>
      ~s(<path d="M60 45H100" stroke="#8b949e" stroke-width="2" stroke-dasharray="4 4"/></svg>)
  end

  defp streams_with_shape(streams, shapes),
    do: for(s <- streams, s.shape in shapes, s.count > 0, do: s)

  defp image_thumbnail(source, streams, middle) do
    Enum.find_value(streams, fn stream ->
      with {:ok, message} <- StreamReader.fetch_nearest(source, stream.name, middle),
           {:ok, small} <- shrink_image(message.data),
           {:ok, data} <- Draw.Jpeg.encode(small, 80) do
        {:ok, "image/jpeg", data}
      else
        _ -> stored_image(source, stream, middle)
      end
    end)
  end

  defp shrink_image(%Image{width: w, height: h} = image) do
    k = min(min(@width / w, @height / h), 1.0)
    ImageOps.Geometry.resize(image, max(round(w * k), 1), max(round(h * k), 1))
  end

  defp shrink_image(_), do: :error

  # A stored JPEG or PNG is sent unchanged, because browsers scale it themselves.
  defp stored_image(source, stream, middle) do
    with {:ok, message} <- StreamReader.fetch_nearest(source, stream.name, middle),
         {:ok, {format, _, _, data, _}} when format in [:jpeg, :png] <-
           Draw.BrowserImage.to_browser_image(message.data) do
      {:ok, "image/#{format}", data}
    else
      _ -> nil
    end
  end

  defp signal_thumbnail(source, streams, extent) do
    Enum.find_value(streams, fn stream ->
      from = max(stream.first || extent.from, extent.from)
      to = min(stream.last || extent.to, extent.to)

      with {:ok, [_ | _] = points, _} <-
             StreamOverview.read_series(
               source,
               stream.name,
               from,
               to,
               max(div(to - from, @bins), 1)
             ),
           ends when ends != nil <- value_range(points) do
        {:ok, "image/svg+xml", render_svg(points, ends, from, to)}
      else
        _ -> nil
      end
    end)
  end

  defp value_range(points) do
    lows = for {_, low, _, _, _} when is_number(low) <- points, do: low
    highs = for {_, _, high, _, _} when is_number(high) <- points, do: high
    if lows == [] or highs == [], do: nil, else: {Enum.min(lows), Enum.max(highs)}
  end

  # Draws a stroke from the minimum to the maximum of each row, and joins adjacent rows except across gaps.
  defp render_svg(points, {low, high}, from, to) do
    x = fn t -> @width * (t - from) / max(to - from, 1) end
    # Quarters avoid an overflow in the difference of very large floats.
    y = fn v -> 4 + (@height - 8) * (1 - (v / 4 - low / 4) / max(high / 4 - low / 4, 1.0e-12)) end
    points = Enum.filter(points, fn {t, a, _, _, _} -> is_number(a) and t >= from and t <= to end)

    # A single value is drawn as a horizontal line.
    points =
      if match?([_], points), do: [hd(points), put_elem(hd(points), 0, to + 1)], else: points

    after_holes = points |> find_gaps() |> MapSet.new(&elem(&1, 1))
    [first | rest] = for point <- points, do: {elem(point, 0), stroke_path(point, x, y)}
    lines = for {t, at} <- rest, do: [if(t in after_holes, do: "M", else: "L"), at]

    [
      ~s(<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 #{@width} #{@height}">),
      ~s(<path d="M),
      [elem(first, 1) | lines],
      ~s(" fill="none" stroke="#4ea1f3" stroke-linecap="square" stroke-linejoin="round"/></svg>)
    ]
  end

  defp find_gaps(points),
    do: Draw.GapDetection.find_gaps(for {t, _, _, _, n} <- points, do: {t, n})

  defp stroke_path({t, low, high, _, _}, x, y),
    do: "#{round_tenths(x.(t))} #{round_tenths(y.(high))}V#{round_tenths(y.(low))}"

  defp round_tenths(x), do: Float.round(x / 1, 1)
end
