defmodule Situ.Studio.VideoExport do
  @moduledoc false
  # Writes the images of a stream between two times as a video file, with the audio of another
  # stream and with overlays from other streams: masks, rectangles, points and their labels, as
  # the page shows them.
  #
  # Each image is shown from its own time until the next one; the first is the image at the start
  # time. An image whose size differs from the first one is resized.
  alias Situ.{AudioBuffer, AudioFormat, EncodedImage, Error, Image, ImageOps}
  alias Situ.Media.Encoder
  alias Situ.Studio.VideoExport.Masks
  alias Situ.Studio.{StreamColors, StreamOverview, StreamReader}
  alias Situ.Studio.Visualizers
  alias Situ.Studio.Visualizers.Shapes

  @enforce_keys [:pictures, :from, :to]
  defstruct [:pictures, :from, :to, :sound, over: [], masks: [], flip: false]

  @typedoc """
  `over` lists the streams that are drawn over the images, each with the number of its color. `masks` lists the
  streams of masks, each with its color and properties (`"opacity"`, `"fit"`, `"labels"`).
  """
  @type t :: %__MODULE__{
          pictures: String.t(),
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          sound: String.t() | nil,
          over: [{String.t(), non_neg_integer()}],
          masks: [{String.t(), non_neg_integer(), map()}],
          flip: boolean()
        }

  @doc """
  Creates the export of the images of a stream between two times. `:over` names the streams that are drawn over them,
  and `:sound` an audio stream.
  """
  @spec new(String.t(), {Situ.Time.t(), Situ.Time.t()}, Situ.Recording.t(), keyword()) ::
          {:ok, t()} | {:error, Error.t()}
  def new(pictures, {from, to}, source, opts) do
    with {:ok, infos} <- StreamOverview.list_streams(source) do
      shapes = Map.new(infos, &{&1.name, &1.shape})
      ranks = StreamColors.rank_streams(Map.keys(shapes))
      over = opts[:over] || []
      colored = Enum.zip(over, StreamColors.assign_colors(over, ranks))

      {masks, over} =
        Enum.split_with(colored, fn {name, _} -> shapes[name] in [:masks, :image] end)

      masks = for {name, color} <- masks, do: {name, color, %{}}
      times = [from: from, to: to]
      fields = [pictures: pictures, sound: opts[:sound], over: over, masks: masks] ++ times
      {:ok, struct!(__MODULE__, fields)}
    end
  end

  # Images and audio are encoded alternately in slices of one second, so that neither waits long for the other.
  @turn 1_000_000_000
  @page 64
  @frame 40_000_000
  # The page's colors in the dark theme: the first eight in the style sheet.
  @style Path.expand("../../../assets/css/theme.css", __DIR__)
  @external_resource @style
  @palette ~r/--s\d: #(..)(..)(..);/
           |> Regex.scan(File.read!(@style), capture: :all_but_first)
           |> Enum.take(8)
           |> Enum.map(fn rgb ->
             rgb |> Enum.map(&String.to_integer(&1, 16)) |> List.to_tuple()
           end)
  @colors List.to_tuple(@palette)

  @doc """
  Writes the file. Calls `progress` with the completed fraction, 0.0 to 1.0, about once per second of video. Errors:
  `:no_pictures`, and errors of `Situ.Media.Encoder`.
  """
  @spec write_video(t(), Situ.Recording.t(), Path.t(), (float() -> term())) ::
          :ok | {:error, Error.t()}
  def write_video(%__MODULE__{} = film, source, path, progress) do
    with {:ok, first} <- first_image(film, source),
         format = audio_format(film, source),
         {:ok, encoder} <-
           Encoder.open(path, video: first, audio: format, start_time: film.from) do
      turns = for a <- film.from..(film.to - 1)//@turn, do: {a, min(a + @turn, film.to)}

      turns
      |> Enum.reduce_while({:ok, nil}, fn {a, b}, {:ok, last} ->
        progress.((a - film.from) / (film.to - film.from))

        with {:ok, last} <- write_images(film, source, encoder, first, a, b, last),
             :ok <- write_audio(film, source, encoder, format, a, b) do
          {:cont, {:ok, last}}
        else
          error -> {:halt, error}
        end
      end)
      |> close_encoder(film, encoder)
    end
  end

  defp close_encoder({:ok, last}, film, encoder) do
    with :ok <- extend_last_image(last, film, encoder), do: Encoder.close(encoder)
  end

  defp close_encoder(error, _film, encoder) do
    _ = Encoder.close(encoder)
    error
  end

  # The last image is repeated near the end time, so that it is shown until then.
  defp extend_last_image({time, image}, %{to: to}, encoder) when to - @frame > time + @frame,
    do: Encoder.video(encoder, to - @frame, image)

  defp extend_last_image(_, _, _), do: :ok

  # Returns the image at the start time, or else the first image after it.
  defp first_image(film, source) do
    with {:ok, message} <- fetch_first_message(film, source),
         {:ok, image} <- decode_image(message.data) do
      {:ok, image}
    else
      {:error, error} -> {:error, error}
      _ -> no_images_error(film)
    end
  end

  defp fetch_first_message(film, source) do
    with {:ok, %{data: data} = message} when is_struct(data) <-
           StreamReader.latest_at(source, film.pictures, film.from) do
      {:ok, message}
    else
      _ -> StreamReader.next_after(source, film.pictures, film.from)
    end
  end

  defp no_images_error(film) do
    {:error,
     Error.new(:no_pictures, "#{film.pictures} has no images between these times",
       fix: "select an interval that contains images"
     )}
  end

  defp decode_image(%EncodedImage{} = encoded), do: ImageOps.parse(encoded, format: :bgr24)
  defp decode_image(%Image{} = image), do: ImageOps.convert(image, :bgr24)
  defp decode_image(_), do: :none

  # The first slice starts with the image at its start time.
  defp write_images(film, source, encoder, first, a, b, nil) do
    opening =
      case StreamReader.latest_at(source, film.pictures, a) do
        {:ok, message} -> [%{message | originating_time: a}]
        _ -> []
      end

    with {:ok, last} <- encode_messages(opening, film, source, encoder, first, nil),
         do: write_pages(film, source, encoder, first, {a + 1, b}, last)
  end

  defp write_images(film, source, encoder, first, a, b, last),
    do: write_pages(film, source, encoder, first, {a + 1, b}, last)

  defp write_pages(film, source, encoder, first, {a, b}, last) do
    with {:ok, messages, more} <- StreamReader.read_messages(source, film.pictures, a, b, @page),
         {:ok, last} <- encode_messages(messages, film, source, encoder, first, last) do
      if more == :more and messages != [],
        do:
          write_pages(
            film,
            source,
            encoder,
            first,
            {List.last(messages).originating_time + 1, b},
            last
          ),
        else: {:ok, last}
    end
  end

  defp encode_messages(messages, film, source, encoder, first, last) do
    Enum.reduce_while(messages, {:ok, last}, fn message, {:ok, last} ->
      time = message.originating_time

      with {:ok, image} <- decode_image(message.data),
           {:ok, image} <- resize_image(image, first),
           found = fetch_masks(film, source, time),
           image = draw_masks(image, found),
           {:ok, image} <- if(film.flip, do: ImageOps.flip(image, :vertical), else: {:ok, image}),
           image =
             draw_overlays(film, image, mask_labels(found) ++ overlay_data(film, source, time)),
           :ok <- Encoder.video(encoder, time, image) do
        {:cont, {:ok, {time, image}}}
      else
        # After a gap or an image that cannot be decoded, the previous image stays visible.
        :none -> {:cont, {:ok, last}}
        {:error, %{code: code}} when code in [:bad_jpeg, :bad_png] -> {:cont, {:ok, last}}
        error -> {:halt, error}
      end
    end)
  end

  defp resize_image(%{width: w, height: h} = image, %{width: w, height: h}), do: {:ok, image}
  defp resize_image(image, %{width: w, height: h}), do: ImageOps.resize(image, w, h)

  defp overlay_data(film, source, time) do
    for {stream, color} <- film.over,
        {:ok, message} <- [StreamReader.latest_at(source, stream, time)],
        do: {message.data, color}
  end

  defp fetch_masks(film, source, time) do
    for {stream, color, props} <- film.masks,
        {:ok, message} <- [StreamReader.latest_at(source, stream, time)],
        {:ok, found} <- [
          Visualizers.Masks.fetch_masks(message.data, source, stream, message.originating_time)
        ],
        do: {found, color, props}
  end

  # Masks are drawn before the image is mirrored, so that they are mirrored with it.
  defp draw_masks(image, found) do
    Enum.reduce(found, image, fn {found, color, props}, image ->
      Masks.draw_masks(image, found, color, @colors, props)
    end)
  end

  defp mask_labels(found) do
    for {{:objects, objects}, color, props} <- found,
        props["labels"] != false,
        do: {{:labels, Enum.map(objects, &elem(&1, 0))}, color}
  end

  @doc """
  Draws overlays on an image: the data of each stream's message, with the number of its color.

      iex> image = Situ.Image.new_filled(32, 16, :bgr24)
      iex> rects = [%Situ.Rect{x: 4, y: 4, width: 8, height: 8}]
      iex> film = %Situ.Studio.VideoExport{pictures: "Camera", from: 0, to: 1}
      iex> drawn = Situ.Studio.VideoExport.draw_overlays(film, image, [{rects, 2}])
      iex> Situ.Image.fetch_pixel(drawn, 4, 8)
      {:ok, [138, 195, 76]}
  """
  @spec draw_overlays(t(), Image.t(), [{term(), non_neg_integer()}]) :: Image.t()
  def draw_overlays(_film, image, []), do: image

  def draw_overlays(film, image, data) do
    shapes = Enum.flat_map(data, fn {term, color} -> build_shapes(film, image, term, color) end)

    case ImageOps.draw(image, shapes) do
      {:ok, drawn} -> drawn
      # Coordinates from a file may be out of range; such overlays are left out.
      {:error, _} -> image
    end
  end

  # Objects with masks are labeled but not framed.
  defp build_shapes(film, image, {:labels, rects}, own),
    do: film |> build_shapes(image, rects, own) |> Enum.reject(&match?({:rectangle, _, _}, &1))

  defp build_shapes(film, image, term, own) do
    shapes = Shapes.collect_shapes(term)

    rects =
      for {[x, y, w, h, label, score, id], i} <- Enum.with_index(shapes["rects"]) do
        color = Enum.at(@palette, rem(abs(id || own + i), length(@palette)))
        x = if film.flip, do: image.width - x - w, else: x

        text =
          join_label([
            label,
            id && to_string(id),
            score && :erlang.float_to_binary(score / 1, decimals: 2)
          ])

        [{:rectangle, {x, y, w, h}, color: color, width: 2}] ++
          if(text == "",
            do: [],
            else: [
              {:text, {x + 3, max(y - 14, 3)}, text, color: :white, background: color, size: 10}
            ]
          )
      end

    color = Enum.at(@palette, rem(own, length(@palette)))
    radius = if length(shapes["points"]) > 100, do: 1, else: 2.5

    across = fn x -> if film.flip, do: image.width - x, else: x end

    lines =
      for [a, b, c, d] <- shapes["lines"],
          do: {:line, {across.(a), b}, {across.(c), d}, color: color, width: 2}

    points =
      for [x, y, _label] <- shapes["points"],
          do: {:fill_circle, {across.(x), y}, radius, color: color}

    texts =
      for {text, i} <- Enum.with_index(shapes["texts"]) do
        {:text, {8, 12 + 22 * i}, text, color: :white, background: color, size: 12}
      end

    List.flatten(rects) ++ lines ++ points ++ texts
  end

  defp join_label(parts), do: parts |> Enum.reject(&(&1 in [nil, ""])) |> Enum.join("  ")

  defp audio_format(%{sound: nil}, _source), do: nil

  defp audio_format(film, source) do
    case StreamReader.next_after(source, film.sound, film.from) do
      {:ok, %{data: %AudioBuffer{format: format}}} -> format
      _ -> nil
    end
  end

  defp write_audio(_film, _source, _encoder, nil, _a, _b), do: :ok

  defp write_audio(film, source, encoder, format, a, b) do
    with {:ok, messages, _} <- StreamReader.read_messages(source, film.sound, a + 1, b, 100_000) do
      for %{data: %AudioBuffer{format: ^format} = buffer, originating_time: time} <- messages,
          reduce: :ok do
        :ok -> Encoder.audio(encoder, time, trim_buffer(buffer, time, film.from))
        error -> error
      end
    end
  end

  # A buffer's timestamp is its end, so part of the first buffer may be from before the start of the video.
  defp trim_buffer(buffer, time, from) do
    early = max(from - AudioBuffer.start_time(buffer, time), 0)
    skip = if early == 0, do: 0, else: AudioFormat.ns_to_frames(buffer.format, early) + 1
    skip = min(skip, AudioBuffer.frame_count(buffer))
    AudioBuffer.slice_frames(buffer, skip, AudioBuffer.frame_count(buffer) - skip)
  end
end
