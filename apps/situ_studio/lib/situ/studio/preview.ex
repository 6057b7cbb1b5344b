defmodule Situ.Studio.Preview do
  @moduledoc """
  Draws values, series and recordings as HTML text without a script, for pages outside of the studio, such as the panels
  of a Phoenix application and the outputs of a notebook.

      iex> Situ.Studio.Preview.kind(20.5)
      :signal
      iex> svg = Situ.Studio.Preview.plot([{"Level", [{0, 1.0}, {1_000_000_000, 3.5}]}])
      iex> svg |> IO.iodata_to_binary() |> String.starts_with?("<svg")
      true

  Images are JPEG or PNG in a `data:` address, all other drawings are SVG in the text colour of the page. Names and
  values are escaped. Times are ns.
  """
  # See docs/adr/0187-panels-in-other-pages-are-drawn-on-the-server.md.
  alias Situ.{AudioBuffer, DepthImage, EncodedImage, Image, ImageOps, PointCloud, Recording}
  alias Situ.Live.Html
  alias Situ.Studio.{StreamOverview, StreamReader}

  @type kind :: :signal | :image | :audio | :cloud | :text
  @type series :: [{name :: String.t(), [{Situ.Time.t(), number()}]}]

  @colors ["#4ea1f3", "#e0823d", "#3fa66b", "#c05fd0", "#d1495b", "#8a8f2a"]
  @max_text 2_000
  @max_points 4_000

  @doc "Returns how a value is drawn. Maps of numbers are signals, too: one line for each key."
  @spec kind(term()) :: kind()
  def kind(%Image{}), do: :image
  def kind(%EncodedImage{}), do: :image
  def kind(%DepthImage{}), do: :image
  def kind(%AudioBuffer{}), do: :audio
  def kind(%PointCloud{}), do: :cloud
  def kind(value), do: if(list_numbers(value) == [], do: :text, else: :signal)

  @doc """
  Returns the numbers in a value that are drawn as lines, with their names.

      iex> Situ.Studio.Preview.list_numbers(%{"a" => 1, "b" => 2.5})
      [{"a", 1}, {"b", 2.5}]
      iex> Situ.Studio.Preview.list_numbers(7)
      [{"", 7}]
  """
  @spec list_numbers(term()) :: [{String.t(), number()}]
  def list_numbers(value) when is_number(value), do: [{"", value}]
  def list_numbers(value) when is_boolean(value), do: [{"", if(value, do: 1, else: 0)}]

  def list_numbers(%{} = map) when not is_struct(map) and map_size(map) in 1..6 do
    numbers = for {key, value} when is_number(value) <- map, do: {to_name(key), value}
    if length(numbers) == map_size(map), do: Enum.sort(numbers), else: []
  end

  def list_numbers(_value), do: []

  defp to_name(key) when is_binary(key) or is_atom(key), do: to_string(key)
  defp to_name(key), do: inspect(key)

  @doc "Draws one value."
  @spec render(term()) :: iodata()
  def render(value) do
    case kind(value) do
      :image -> render_image(value)
      :audio -> render_audio(value)
      :cloud -> render_cloud(value)
      _ -> ["<pre>", escape_text(describe_value(value)), "</pre>"]
    end
  end

  defp describe_value(value) when is_binary(value) do
    if String.valid?(value),
      do: String.slice(value, 0, @max_text),
      else: inspect(value, limit: 64)
  end

  defp describe_value(value),
    do: inspect(value, pretty: true, limit: 50, printable_limit: @max_text)

  @doc "Encodes an image for a browser, with its media type. Depth is coloured from near to far."
  @spec encode_image(Image.t() | EncodedImage.t() | DepthImage.t()) ::
          {:ok, String.t(), iodata()} | {:error, Situ.Error.t()}
  def encode_image(%EncodedImage{format: format, data: data}) when format in [:jpeg, :png],
    do: {:ok, "image/#{format}", data}

  def encode_image(%EncodedImage{} = encoded) do
    with {:ok, image} <- ImageOps.parse(encoded), do: encode_image(image)
  end

  def encode_image(%DepthImage{} = depth) do
    with {:ok, image} <- ImageOps.pseudo_colorize(depth, {0.3, 6.0}), do: encode_image(image)
  end

  def encode_image(%Image{} = image) do
    with {:ok, encoded} <- ImageOps.encode_jpeg(image, quality: 80),
         do: {:ok, "image/jpeg", encoded.data}
  end

  defp render_image(value) do
    case encode_image(value) do
      {:ok, type, data} ->
        data = data |> IO.iodata_to_binary() |> Base.encode64()
        [~s(<img alt="" style="max-width:100%" src="data:), type, ";base64,", data, ~s(">)]

      {:error, error} ->
        ["<pre>", escape_text(error.what), "</pre>"]
    end
  end

  defp render_audio(%AudioBuffer{} = audio) do
    points = AudioBuffer.points(audio, AudioBuffer.duration_ns(audio))
    low = for {time, low, _high, _last, _n} when is_number(low) <- points, do: {time, low}
    high = for {time, _low, high, _last, _n} when is_number(high) <- points, do: {time, high}

    [
      ~s(<div>),
      plot([{"", low ++ Enum.reverse(high)}], height: 80),
      escape_text(inspect(audio)),
      "</div>"
    ]
  end

  # An orthographic view from above and the side. Colours come from the cloud, or from the height.
  defp render_cloud(%PointCloud{} = cloud) do
    step = max(div(PointCloud.point_count(cloud), @max_points), 1)
    points = cloud |> PointCloud.to_points() |> Enum.take_every(step)
    flat = for {x, y, z} <- points, do: {0.87 * (x - y), -z + 0.5 * (x + y), z}
    {left, right} = value_range(for {x, _, _} <- flat, do: x)
    {top, bottom} = value_range(for {_, y, _} <- flat, do: y)
    {low, high} = value_range(for {_, _, z} <- flat, do: z)
    scale = max(right - left, bottom - top)

    dots =
      for {x, y, z} <- flat do
        hue = round(240 - 200 * (z - low) / max(high - low, 1.0e-9))
        at = "#{round_tenths(300 * (x - left) / scale)} #{round_tenths(300 * (y - top) / scale)}"
        ~s(<path stroke="hsl\(#{hue} 70% 50%\)" d="M#{at}h1"/>)
      end

    [
      ~s(<svg xmlns="http://www.w3.org/2000/svg" viewBox="-4 -4 308 308" width="308" fill="none" stroke-width="1.5">),
      [dots | "</svg>"]
    ]
  end

  @doc "Draws series over time in one plot. Options: `width:` and `height:` in pixels."
  @spec plot(series(), keyword()) :: iodata()
  def plot(series, opts \\ []) do
    {width, height} = {opts[:width] || 480, opts[:height] || 140}

    series =
      for {name, points} <- series,
          do: {name, for({t, v} <- points, drawable_value?(v), do: {t, v})}

    points = Enum.flat_map(series, &elem(&1, 1))
    {from, to} = value_range(for {t, _} <- points, do: t)
    {low, high} = value_range(for {_, v} <- points, do: v / 1)

    place = fn {t, v} ->
      # Quarters avoid an overflow in the difference of very large floats.
      y = (v / 4 - low / 4) / (high / 4 - low / 4)

      "#{round_tenths((width - 60) * (t - from) / (to - from))} #{round_tenths(14 + (height - 20) * (1 - y))}"
    end

    [
      ~s(<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 #{width} #{height}" width="#{width}" style="max-width:100%" ),
      ~s(font-family="sans-serif" font-size="11" fill="currentColor">),
      if(points == [], do: [], else: axis_labels(width, height, {low, high})),
      for({{name, points}, i} <- Enum.with_index(series), do: plot_line(name, points, i, place)),
      "</svg>"
    ]
  end

  defp axis_labels(width, height, {low, high}) do
    [
      ~s(<text x="#{width - 56}" y="20">#{shorten_text(high)}</text>),
      ~s(<text x="#{width - 56}" y="#{height - 4}">#{shorten_text(low)}</text>)
    ]
  end

  defp plot_line(_name, [], _i, _place), do: []

  defp plot_line(name, points, i, place) do
    color = Enum.at(@colors, rem(i, length(@colors)))
    path = points |> Enum.map(place) |> Enum.intersperse("L")
    [{_, latest} | _] = Enum.reverse(points)
    label = if name == "", do: shorten_text(latest), else: "#{name} #{shorten_text(latest)}"

    [
      ~s(<path fill="none" stroke="#{color}" stroke-width="1.5" d="M),
      path,
      ~s("/><text x="#{4 + 120 * i}" y="10" fill="#{color}">),
      [escape_text(label) | "</text>"]
    ]
  end

  @doc "Draws the streams of a recording over time: signals as lines, all others as marks at their messages."
  @spec timeline(Recording.t(), keyword()) :: {:ok, iodata()} | {:error, Situ.Error.t()}
  def timeline(recording, opts \\ []) do
    with {:ok, streams} <- StreamOverview.list_streams(recording),
         {:ok, extent} <- StreamReader.fetch_extent(recording) do
      width = opts[:width] || 720
      extent = %{extent | to: max(extent.to, extent.from + 1)}

      rows =
        for {stream, i} <- Enum.with_index(streams),
            do: timeline_row(recording, stream, extent, {i, width})

      height = 26 * length(streams) + 20

      {:ok,
       [
         ~s(<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 #{width} #{height}" width="#{width}" ),
         ~s(style="max-width:100%" font-family="sans-serif" font-size="11" fill="currentColor">),
         rows,
         ~s(<text x="180" y="#{height - 6}">0 s</text><text x="#{width}" y="#{height - 6}" text-anchor="end">),
         [shorten_text((extent.to - extent.from) / 1.0e9), " s</text></svg>"]
       ]}
    end
  end

  defp timeline_row(recording, stream, extent, {i, width}) do
    y = 26 * i

    x = fn t ->
      round_tenths(180 + (width - 180) * (t - extent.from) / (extent.to - extent.from))
    end

    [
      ~s(<text x="0" y="#{y + 15}">),
      [
        escape_text(String.slice(stream.name, 0, 28)),
        ~s(</text><path fill="none" stroke="#{hd(@colors)}" d=")
      ],
      row_path(recording, stream, extent, {x, y}),
      ~s("/>)
    ]
  end

  defp row_path(recording, %{shape: shape} = stream, extent, {x, y})
       when shape in [:signal, :audio] do
    bin = max(div(extent.to - extent.from, 400), 1)

    case StreamOverview.read_series(recording, stream.name, extent.from, extent.to, bin) do
      {:ok, [_ | _] = points, _} ->
        points =
          for {t, low, high, _, _} <- points,
              drawable_value?(low),
              drawable_value?(high),
              do: {t, low / 1, high / 1}

        {low, high} = value_range(Enum.flat_map(points, &[elem(&1, 1), elem(&1, 2)]))

        place = fn v ->
          round_tenths(y + 3 + 20 * (1 - (v / 4 - low / 4) / (high / 4 - low / 4)))
        end

        strokes = for {t, low, high} <- points, do: "#{x.(t)} #{place.(high)}V#{place.(low)}"
        if strokes == [], do: "", else: ["M" | Enum.intersperse(strokes, "L")]

      _ ->
        ""
    end
  end

  defp row_path(recording, stream, extent, {x, y}) do
    case StreamReader.read_marks(recording, stream.name, extent.from, extent.to, 400) do
      {:ok, marks, _} -> for {t, _latency} <- marks, do: "M#{x.(t)} #{y + 5}v14"
      _ -> ""
    end
  end

  # A difference of larger numbers is not a float.
  defp drawable_value?(value), do: is_number(value) and abs(value) < 1.0e300

  # A range that is never empty.
  defp value_range([]), do: {0.0, 1.0}

  defp value_range(values) do
    case {Enum.min(values), Enum.max(values)} do
      {same, same} when is_integer(same) -> {same - 1, same + 1}
      # A float keeps about 15 digits, so a fixed step would not change a large one.
      {same, same} -> {same - abs(same) * 1.0e-6 - 0.5, same + abs(same) * 1.0e-6 + 0.5}
      ends -> ends
    end
  end

  defp shorten_text(value) when is_integer(value), do: Integer.to_string(value)

  defp shorten_text(value) when abs(value) > 1.0e15,
    do: :erlang.float_to_binary(value / 1, [:short])

  defp shorten_text(value), do: :erlang.float_to_binary(value / 1, [:compact, decimals: 3])

  defp round_tenths(x), do: Float.round(x / 1, 1)

  defp escape_text(text), do: text |> Html.escape() |> Html.to_iodata()
end
