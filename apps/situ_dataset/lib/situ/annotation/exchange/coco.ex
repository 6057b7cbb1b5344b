defmodule Situ.Annotation.Exchange.Coco do
  @moduledoc false
  # Reads and writes COCO's JSON format for boxes on images
  # (https://cocodataset.org/#format-data).
  #
  # Boxes are annotations with the numbers `x`, `y`, `width` and `height` (pixels). Each key frame
  # is a box on the image of its time. `times:` gives the times of the images: every image between
  # the first and the last key frame of a track then gets a box, interpolated linearly between the
  # two nearest key frames.
  #
  # The category is the value of the first finite attribute, or else the schema's name. COCO
  # readers skip unknown fields, so the file also contains the other data: `time_ns` of an image;
  # `track`, `track_id`, `attributes`, `score`, `by`, `note` and `proposed` of a box.
  #
  # Images in files of other programs have no times: they are read one second apart, in the order
  # of their names.
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation
  alias Situ.Annotation.Exchange.BoxTracks
  alias Situ.Annotation.{Layer, Schema}

  @box_keys ~w(x y width height)
  @second 1_000_000_000

  @impl true
  def encode(layer, opts) do
    {boxes, others} = layer |> Layer.annotations() |> Enum.split_with(&BoxTracks.box?/1)
    lasting = Enum.filter(boxes, &(&1.from < &1.to))
    image_boxes = boxes_on_images(layer, boxes, opts[:times])

    by = Enum.find(layer.schema.attributes, &(&1.kind == :finite))

    categories =
      number_values(if by, do: Enum.map(by.values, & &1.value), else: [layer.schema.name])

    pictures = image_boxes |> Enum.map(& &1.from) |> Enum.uniq() |> Enum.sort() |> number_values()
    tracks = number_values(Layer.track_names(layer))

    file = %{
      "info" => %{
        "description" => layer.schema.name,
        "situ" => %{"schema" => Schema.to_json(layer.schema), "origin" => opts[:origin]}
      },
      "licenses" => [],
      "images" => for({time, id} <- sort_by_id(pictures), do: encode_image(time, id, opts)),
      "categories" =>
        for(
          {name, id} <- sort_by_id(categories),
          do: %{"id" => id, "name" => name, "supercategory" => ""}
        ),
      "annotations" =>
        for {a, id} <- image_boxes |> Enum.sort_by(&{&1.from, &1.track}) |> Enum.with_index(1) do
          category = if by, do: a.values[by.name], else: layer.schema.name
          ids = {id, pictures[a.from], categories[category], tracks[a.track]}
          encode_annotation(a, ids, Map.drop(a.values, @box_keys))
        end
    }

    {Situ.JSON.encode_pretty(file) <> "\n", describe_losses(others, lasting, opts[:times])}
  end

  defp number_values(values), do: values |> Enum.with_index(1) |> Map.new()
  defp sort_by_id(ids), do: Enum.sort_by(ids, &elem(&1, 1))

  defp encode_image(time, id, opts) do
    seconds = :erlang.float_to_binary((time - opts[:origin]) / @second, decimals: 6)
    name = if opts[:media], do: "#{opts[:media]}##{seconds}", else: "#{time}.jpg"
    %{"id" => id, "file_name" => name, "time_ns" => time}
  end

  defp encode_annotation(a, {id, picture, category, track}, attributes) do
    [_, _, width, height] = box = Enum.map(@box_keys, &a.values[&1])

    %{
      "id" => id,
      "image_id" => picture,
      "category_id" => category,
      "bbox" => box,
      "area" => width * height,
      "iscrowd" => 0,
      "segmentation" => [],
      "track" => a.track,
      "track_id" => track,
      "attributes" => attributes,
      "score" => a.confidence,
      "by" => a.by,
      "note" => a.note,
      "proposed" => if(a.proposed?, do: true)
    }
    |> Map.reject(fn {_, value} -> value == nil end)
  end

  # Without times of images, each box has a separate image.
  defp boxes_on_images(_layer, boxes, nil), do: for(box <- boxes, do: %{box | to: box.from})

  defp boxes_on_images(layer, _boxes, times) do
    for {_track, boxes} <- BoxTracks.boxes_on_images(layer, BoxTracks.image_times(layer, times)),
        {_image, box, _key?} <- boxes,
        do: %{box | to: box.from}
  end

  defp describe_losses(others, lasting, times) do
    [
      others != [] &&
        "COCO stores only boxes: #{length(others)} annotations without x, y, width and height are left out",
      lasting != [] and times == nil &&
        "COCO stores boxes on images: #{length(lasting)} annotations with a duration are only at their start " <>
          "(name the image stream)",
      times != nil &&
        "COCO does not store which boxes are key frames: each image has its own box"
    ]
    |> Enum.filter(& &1)
  end

  @impl true
  def decode(text, opts) do
    case Situ.JSON.decode(text) do
      {:ok,
       %{"images" => images, "annotations" => annotations, "categories" => categories} = file}
      when is_list(images) and is_list(annotations) and is_list(categories) ->
        decode_file(file, category_names(categories), opts)

      {:ok, _} ->
        {:error, "it does not have the \"images\", \"annotations\" and \"categories\" of COCO"}

      {:error, :bad_json} ->
        {:error, "it is not JSON"}
    end
  end

  defp category_names(categories) do
    for %{"id" => id, "name" => name} <- categories,
        is_integer(id) and is_binary(name),
        into: %{},
        do: {id, name}
  end

  defp decode_file(file, categories, opts) do
    own = situ_metadata(file["info"])
    origin = opts[:origin] || if(is_integer(own["origin"]), do: own["origin"], else: 0)
    moved = if is_integer(own["origin"]), do: origin - own["origin"], else: 0
    schema = opts[:schema] || parse_schema(own["schema"], categories)
    {times, untimed} = image_times(file["images"], origin, moved)

    results = Enum.map(file["annotations"], &decode_box(&1, {categories, times, schema}))
    boxes = for {:ok, a} <- results, do: a
    bad = length(results) - length(boxes)

    losses =
      [
        untimed > 0 &&
          "#{untimed} images have no time: they are one second apart, in the order of their names",
        bad > 0 &&
          "#{bad} annotations are not boxes on an image of the file or do not fit the schema, and are left out"
      ]
      |> Enum.filter(& &1)

    {:ok, schema, Enum.sort_by(boxes, &{&1.from, &1.track}), losses}
  end

  defp situ_metadata(%{"situ" => %{} = own}), do: own
  defp situ_metadata(_), do: %{}

  defp parse_schema(json, categories) do
    case json && Schema.parse(json) do
      {:ok, schema} -> schema
      _ -> build_box_schema(categories |> Map.values() |> Enum.uniq() |> Enum.sort())
    end
  end

  defp build_box_schema(names) do
    numbers = for name <- @box_keys, do: %{"name" => name, "kind" => "number"}
    names = if names == [], do: ["box"], else: names
    values = for name <- names, do: %{"value" => name}
    finite = %{"name" => "Label", "kind" => "finite", "values" => values}
    {:ok, schema} = Schema.parse(%{"name" => "Boxes", "attributes" => [finite | numbers]})
    schema
  end

  # Returns the time of each image by its id.
  defp image_times(images, origin, moved) do
    {timed, untimed} =
      images
      |> Enum.filter(&match?(%{"id" => _}, &1))
      |> Enum.split_with(&is_integer(&1["time_ns"]))

    spaced =
      for {image, k} <-
            untimed |> Enum.sort_by(&string_or_empty(&1["file_name"])) |> Enum.with_index(),
          do: {image["id"], origin + k * @second}

    {Map.new(spaced ++ for(i <- timed, do: {i["id"], i["time_ns"] + moved})), length(untimed)}
  end

  defp string_or_empty(text), do: if(is_binary(text), do: text, else: "")

  defp decode_box(
         %{"bbox" => [x, y, w, h] = numbers, "image_id" => image} = json,
         {categories, times, schema}
       )
       when is_number(x) and is_number(y) and is_number(w) and is_number(h) do
    name = categories[json["category_id"]]
    finite = Enum.find(schema.attributes, &(&1.kind == :finite))
    more = if is_map(json["attributes"]), do: json["attributes"], else: %{}
    labelled = if finite && name, do: %{finite.name => name}, else: %{}
    known = for attribute <- schema.attributes, do: attribute.name

    values =
      more
      |> Map.merge(labelled)
      |> Map.merge(Map.new(Enum.zip(@box_keys, numbers)))
      |> Map.take(known)

    with {:ok, time} <- Map.fetch(times, image),
         :ok <- Schema.check_values(schema, values),
         annotation = %Annotation{
           from: time,
           to: time,
           track: track_name(json, name),
           values: values,
           by: string_or_nil(json["by"]),
           note: string_or_nil(json["note"]),
           confidence: if(is_number(json["score"]), do: json["score"]),
           proposed?: json["proposed"] == true
         },
         :ok <- Annotation.check_fields(annotation) do
      {:ok, annotation}
    else
      _ -> :error
    end
  end

  defp decode_box(_json, _known), do: :error

  defp track_name(%{"track" => track}, _name) when is_binary(track) and track != "", do: track
  defp track_name(%{"track_id" => id}, name) when is_integer(id), do: "#{name || "box"} #{id}"
  defp track_name(_json, name), do: name || "box"

  defp string_or_nil(value), do: if(is_binary(value), do: value)
end
