defmodule Situ.Annotation.Exchange.Cvat do
  @moduledoc false
  # Reads and writes the XML of CVAT for videos (version 1.1): a track with a box for each image, of which the key
  # frames are marked. CVAT interpolates between key frames, so without `times:` only key frames are written. An
  # `outside` box ends a track. Readers need the size of the images, which a layer does not know, so the file states
  # the smallest size that contains all boxes. The meta data has the times of the images, so that a file of Situ keeps
  # them. Images of other files are read 40 ms apart.
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation
  alias Situ.Annotation.Exchange.BoxTracks
  alias Situ.Xml

  @frame_ns 40_000_000

  @impl true
  def encode(layer, opts) do
    times = BoxTracks.image_times(layer, opts[:times])
    tracks = BoxTracks.boxes_on_images(layer, times)
    schema = layer.schema
    labels = BoxTracks.labels(schema)

    text = [
      ~s(<?xml version="1.0" encoding="utf-8"?>\n<annotations>\n  <version>1.1</version>\n  <meta>\n),
      ~s(    <task><name>#{Xml.escape(schema.name)}</name><size>#{length(times)}</size><mode>interpolation</mode>),
      ~s(<start_frame>0</start_frame><stop_frame>#{max(length(times) - 1, 0)}</stop_frame><labels>),
      for(
        l <- labels,
        do: ~s(<label><name>#{Xml.escape(l)}</name><attributes></attributes></label>)
      ),
      ~s(</labels>#{encode_size(tracks)}</task>\n    <situ_times>#{Enum.join(times, " ")}</situ_times>\n  </meta>\n),
      for(
        {track, n} <- Enum.with_index(tracks),
        do: encode_track(track, n, {schema, length(times)})
      ),
      "</annotations>\n"
    ]

    {text, BoxTracks.describe_others(layer, "CVAT")}
  end

  defp encode_size(tracks) do
    corners =
      for {_, boxes} <- tracks, {_, box, _} <- boxes do
        [x, y, width, height] = BoxTracks.position(box)
        {x + width, y + height}
      end

    [width, height] =
      for n <- [0, 1], do: corners |> Enum.map(&elem(&1, n)) |> Enum.max(fn -> 1 end) |> ceil()

    "<original_size><width>#{width}</width><height>#{height}</height></original_size>"
  end

  # CVAT has numbers of tracks only. Its readers skip the additional attribute with the name.
  defp encode_track({name, [{_, first, _} | _] = boxes}, n, {schema, images}) do
    next = for({image, _, _} <- Enum.drop(boxes, 1), do: image) ++ [images]

    [
      ~s(  <track id="#{n}" label="#{Xml.escape(BoxTracks.label(first, schema))}" source="manual" ),
      ~s(situ_track="#{Xml.escape(name)}">\n),
      boxes |> Enum.zip(next) |> Enum.map(&encode_until/1),
      "  </track>\n"
    ]
  end

  defp encode_track({_name, []}, _n, _), do: []

  # On the image after the last box of a track, or before a gap, the box is outside.
  defp encode_until({{image, box, key?}, next}) do
    outside = if next > image + 1, do: [encode_box({image + 1, box, true}, 1)], else: []
    [encode_box({image, box, key?}, 0), outside]
  end

  defp encode_box({image, box, key?}, outside) do
    [x, y, width, height] = BoxTracks.position(box)

    ~s(    <box frame="#{image}" keyframe="#{if key?, do: 1, else: 0}" outside="#{outside}" occluded="0" ) <>
      ~s(xtl="#{x}" ytl="#{y}" xbr="#{x + width}" ybr="#{y + height}" z_order="0"></box>\n)
  end

  @impl true
  def decode(text, opts) do
    with {:ok, {"annotations", _, _} = document} <- Xml.parse(text) do
      tracks = Xml.list_children(document, "track")
      labels = for {_, %{"label" => label}, _} <- tracks, uniq: true, do: label

      schema = opts[:schema] || BoxTracks.build_schema(opts[:name] || "Boxes", Enum.sort(labels))

      times = opts[:times] || read_times(document)

      context = %{
        schema: schema,
        times: times && List.to_tuple(times),
        origin: opts[:origin] || 0
      }

      boxes = Enum.flat_map(tracks, &read_track(&1, context))
      {annotations, bad} = Enum.split_with(boxes, &match?(%Annotation{}, &1))

      losses = if bad == [], do: [], else: ["#{length(bad)} boxes are not valid and are left out"]
      {:ok, schema, annotations, losses ++ describe_shapes(tracks)}
    else
      {:ok, {name, _, _}} -> {:error, "its root is #{inspect(name)}, not annotations"}
      {:error, why} -> {:error, why}
    end
  end

  defp read_times(document) do
    with [meta | _] <- Xml.list_children(document, "meta"),
         [times | _] <- Xml.list_children(meta, "situ_times"),
         parsed = times |> Xml.text_content() |> String.split() |> Enum.map(&Integer.parse/1),
         true <- Enum.all?(parsed, &match?({_, ""}, &1)) do
      Enum.map(parsed, &elem(&1, 0))
    else
      _ -> nil
    end
  end

  # Only key frames are annotations, because the boxes between them follow from them.
  defp read_track({_, attributes, _} = track, context) do
    name = attributes["situ_track"] || attributes["id"] || "1"

    for {_, %{} = box, _} <- Xml.list_children(track, "box"),
        box["outside"] != "1",
        box["keyframe"] != "0",
        do: read_box(box, {name, attributes["label"]}, context)
  end

  defp read_box(box, {name, label}, context) do
    numbers = for key <- ~w(frame xtl ytl xbr ybr), do: parse_number(box[key])

    with [frame, left, top, right, bottom] <- numbers,
         true <- Enum.all?(numbers, &is_number/1) and is_integer(frame) and name != "",
         time when time != nil <- image_time(frame, context) do
      values = %{"x" => left, "y" => top, "width" => right - left, "height" => bottom - top}
      Annotation.new(time, time, name, Map.merge(values, label_value(context.schema, label)))
    else
      _ -> :error
    end
  end

  defp parse_number(nil), do: nil

  defp parse_number(text) do
    case {Integer.parse(text), Float.parse(text)} do
      {{n, ""}, _} -> n
      {_, {x, ""}} -> x
      _ -> nil
    end
  end

  defp image_time(frame, %{times: nil, origin: origin}) when frame >= 0 and frame < 1_000_000_000,
    do: origin + frame * @frame_ns

  defp image_time(frame, %{times: times})
       when times != nil and frame >= 0 and frame < tuple_size(times),
       do: elem(times, frame)

  defp image_time(_frame, _context), do: nil

  defp label_value(schema, label) do
    case Enum.find(schema.attributes, &(&1.kind == :finite)) do
      nil ->
        %{}

      attribute ->
        if Enum.any?(attribute.values, &(&1.value == label)),
          do: %{attribute.name => label},
          else: %{}
    end
  end

  defp describe_shapes(tracks) do
    others = for {_, _, shapes} <- tracks, {kind, _, _} <- shapes, kind != "box", do: kind

    if others == [], do: [], else: ["#{length(others)} shapes are not boxes and are left out"]
  end
end
