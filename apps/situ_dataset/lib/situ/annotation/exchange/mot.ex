defmodule Situ.Annotation.Exchange.Mot do
  @moduledoc false
  # Reads and writes the text format of the MOT Challenge (https://motchallenge.net/instructions): a line for each box
  # on an image, `image, track, left, top, width, height, confidence, class, visibility`. Images, tracks and pixels are
  # counted from 1. `times:` gives the times of the images. Without it, the images are the key frames, and images of a
  # file are read 40 ms apart.
  @behaviour Situ.Annotation.Exchange
  alias Situ.{Annotation, Error}
  alias Situ.Annotation.Attribute
  alias Situ.Annotation.Exchange.BoxTracks

  @frame_ns 40_000_000

  @impl true
  def encode(layer, opts) do
    times = BoxTracks.image_times(layer, opts[:times])
    tracks = BoxTracks.boxes_on_images(layer, times)
    classes = layer.schema |> BoxTracks.labels() |> Enum.with_index(1) |> Map.new()

    rows =
      for {{_name, boxes}, id} <- Enum.with_index(tracks, 1), {image, box, _key?} <- boxes do
        class = Map.get(classes, BoxTracks.label(box, layer.schema), 1)
        confidence = box.confidence || 1
        [x, y, width, height] = BoxTracks.position(box)
        {image, id, [image + 1, id, x + 1, y + 1, width, height, confidence, class, 1]}
      end

    lines =
      for {_, _, cells} <- Enum.sort(rows), do: [Enum.map_join(cells, ",", &to_string/1), "\n"]

    names = for {{name, _}, id} <- Enum.with_index(tracks, 1), name != "#{id}", do: name

    losses =
      if names == [],
        do: [],
        else: ["MOT numbers the tracks: the names #{Enum.join(names, ", ")} are lost"]

    {lines, BoxTracks.describe_others(layer, "MOT") ++ losses}
  end

  @impl true
  def decode(text, opts) do
    with {:ok, rows} <-
           text |> String.split(~r/\r?\n/, trim: true) |> Error.map_ok(&parse_line/1),
         do: build_boxes(rows, opts)
  end

  defp parse_line(line) do
    with :error <- parse_row(line),
         do: {:error, "the line #{inspect(String.slice(line, 0, 60))} is not a box"}
  end

  defp parse_row(line) do
    cells = line |> String.split(~r/[,\s]+/, trim: true) |> Enum.map(&Attribute.parse_number/1)

    case cells do
      [image, track, x, y, width, height | rest] ->
        numbers? = Enum.all?(cells, &is_number/1)
        whole? = is_number(image) and is_number(track) and trunc(image) == image and image >= 1

        if numbers? and whole? and abs(track) < 1.0e9 and image < 1.0e9,
          do: {:ok, {trunc(image), trunc(track), [x, y, width, height], rest}},
          else: :error

      _ ->
        :error
    end
  end

  defp build_boxes(rows, opts) do
    classes = for {_, _, _, [_, class | _]} <- rows, uniq: true, do: to_string(class)

    schema = opts[:schema] || BoxTracks.build_schema(opts[:name] || "Boxes", Enum.sort(classes))

    labelled = Enum.find(schema.attributes, &(&1.kind == :finite))
    times = opts[:times] && List.to_tuple(opts[:times])

    annotations =
      for {image, track, [x, y, width, height], rest} <- rows,
          time = image_time(image, times, opts[:origin] || 0) do
        values = %{"x" => x - 1, "y" => y - 1, "width" => width, "height" => height}
        values = Map.merge(values, label_value(labelled, rest))
        Annotation.new(time, time, "#{track}", values, confidence: confidence(rest))
      end

    {:ok, schema, annotations, missing_losses(length(rows) - length(annotations))}
  end

  defp missing_losses(0), do: []
  defp missing_losses(n), do: ["#{n} boxes are on images that do not exist"]

  defp image_time(image, nil, origin), do: origin + (image - 1) * @frame_ns

  defp image_time(image, times, _origin) when image <= tuple_size(times),
    do: elem(times, image - 1)

  defp image_time(_image, _times, _origin), do: nil

  # A class is the number of a value, or a value.
  defp label_value(%{name: name, values: values}, [_, class | _]) do
    known = Enum.map(values, & &1.value)

    cond do
      to_string(class) in known -> %{name => to_string(class)}
      is_integer(class) and class in 1..length(known) -> %{name => Enum.at(known, class - 1)}
      true -> %{}
    end
  end

  defp label_value(_attribute, _rest), do: %{}

  defp confidence([c | _]) when c >= 0 and c < 1, do: c / 1
  defp confidence(_), do: nil
end
