defmodule Situ.Annotation.Exchange.BoxTracks do
  @moduledoc false
  # The boxes of a layer on the images of a video, for the formats that count images: key frames, or a box on every
  # image, interpolated linearly between the two nearest key frames.
  alias Situ.Annotation
  alias Situ.Annotation.Layer

  @box_keys ~w(x y width height)

  @doc "Returns whether an annotation is a box on an image."
  @spec box?(Annotation.t()) :: boolean()
  def box?(a), do: Enum.all?(@box_keys, &is_number(a.values[&1]))

  @doc "Returns the position of a box as `[x, y, width, height]` in pixels."
  @spec position(Annotation.t()) :: [number()]
  def position(a), do: Enum.map(@box_keys, &a.values[&1])

  @doc "Returns the times of the images, in order: those given, or the times of the key frames."
  @spec image_times(Layer.t(), [Situ.Time.t()] | nil) :: [Situ.Time.t()]
  def image_times(layer, nil) do
    for(a <- Layer.annotations(layer), box?(a), do: a.from) |> Enum.uniq() |> Enum.sort()
  end

  def image_times(_layer, times), do: times |> Enum.uniq() |> Enum.sort()

  @doc """
  Returns the boxes of each track on each image: `[{track, [{index of the image, box, key_frame?}]}]`. A box that lasts
  is on all images of its interval.
  """
  @spec boxes_on_images(Layer.t(), [Situ.Time.t()]) ::
          [{String.t(), [{non_neg_integer(), Annotation.t(), boolean()}]}]
  def boxes_on_images(layer, times) do
    numbered = Enum.with_index(times)

    for track <- Layer.track_names(layer),
        frames = Enum.filter(Layer.on_track(layer, track), &box?/1),
        frames != [] do
      boxes = for {time, n} <- numbered, {box, key?} <- box_at(frames, time), do: {n, box, key?}
      {track, boxes}
    end
  end

  defp box_at(frames, time) do
    before = frames |> Enum.take_while(&(&1.from <= time)) |> List.last()
    later = Enum.find(frames, &(&1.from > time))

    cond do
      before == nil ->
        []

      before.from == time ->
        [{before, true}]

      before.from < before.to ->
        if(time <= before.to, do: [{at_time(before, time), false}], else: [])

      later == nil or later.from < later.to ->
        []

      true ->
        [{interpolate(before, later, time), false}]
    end
  end

  defp at_time(box, time), do: %{box | from: time, to: time}

  defp interpolate(before, later, time) do
    part = (time - before.from) / (later.from - before.from)

    numbers =
      for name <- @box_keys, into: %{} do
        {a, b} = {before.values[name], later.values[name]}
        {name, a + part * (b - a)}
      end

    at_time(%{before | values: Map.merge(before.values, numbers)}, time)
  end

  @doc "Returns the label of a box: the value of the first finite attribute, or the schema's name."
  @spec label(Annotation.t(), Situ.Annotation.Schema.t()) :: String.t()
  def label(a, schema) do
    case Enum.find(schema.attributes, &(&1.kind == :finite)) do
      nil -> schema.name
      attribute -> a.values[attribute.name]
    end
  end

  @doc "Returns all labels in the order of the schema."
  @spec labels(Situ.Annotation.Schema.t()) :: [String.t()]
  def labels(schema) do
    case Enum.find(schema.attributes, &(&1.kind == :finite)) do
      nil -> [schema.name]
      attribute -> Enum.map(attribute.values, & &1.value)
    end
  end

  @doc "Builds the schema of boxes with labels."
  @spec build_schema(String.t(), [String.t()]) :: Situ.Annotation.Schema.t()
  def build_schema(name, labels) do
    values = for label <- labels, do: %{"value" => label}
    numbers = for key <- @box_keys, do: %{"name" => key, "kind" => "number"}

    finite = %{"name" => "Label", "kind" => "finite", "values" => values}
    attributes = if labels == [], do: numbers, else: [finite | numbers]
    {:ok, schema} = Situ.Annotation.Schema.parse(%{"name" => name, "attributes" => attributes})
    schema
  end

  @doc "Describes, in a list of sentences, how many annotations are not boxes."
  @spec describe_others(Layer.t(), String.t()) :: [String.t()]
  def describe_others(layer, format) do
    case Enum.count(Layer.annotations(layer), &(not box?(&1))) do
      0 -> []
      n -> ["#{format} stores boxes: #{n} other annotations are left out"]
    end
  end
end
