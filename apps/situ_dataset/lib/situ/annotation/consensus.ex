defmodule Situ.Annotation.Consensus do
  @moduledoc """
  Compares the layers of any number of annotators over time, and makes one layer of them.

      iex> alias Situ.Annotation.{Consensus, Layer, Schema}
      iex> schema = Schema.finite("S", ["speaks"])
      iex> {:ok, a} = Layer.new(schema, [Situ.Annotation.new(0, 60, "P1")])
      iex> {:ok, b} = Layer.new(schema, [Situ.Annotation.new(20, 60, "P1")])
      iex> {:ok, found} = Consensus.find_segments([{"Ada", a}, {"Ben", b}])
      iex> for s <- found, do: {s.from, s.to, s.labels, s.agree?}
      [{0, 20, %{"Ada" => "speaks", "Ben" => nil}, false}, {20, 60, %{"Ada" => "speaks", "Ben" => "speaks"}, true}]
      iex> {:ok, layer} = Consensus.build_layer(schema, found, "S")
      iex> for x <- Layer.annotations(layer), do: {x.from, x.to, x.proposed?, x.confidence}
      [{0, 20, true, 0.5}, {20, 60, false, 1.0}]
  """
  alias Situ.{Annotation, Error, Options}
  alias Situ.Annotation.{Layer, Schema}

  @options [
    attribute: [type: :string, doc: "The attribute to compare. Default: the first of the schema."],
    tolerance: [
      type: :non_neg_integer,
      default: 0,
      doc:
        "Disagreements of at most this duration (ns) are ignored; the label is the one of the segment before or after."
    ]
  ]

  Options.add_to_moduledoc(__MODULE__, @options)

  @typedoc "A span of a track in which no annotator's label changes. A label is `nil` without an annotation."
  @type segment :: %{
          track: String.t(),
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          labels: %{String.t() => term()},
          agree?: boolean()
        }

  @doc """
  Returns the segments of all tracks in which at least one annotator has a label, sorted by track and time. Points are
  left out. Errors: `:unknown_attribute`, `:no_layers`.
  """
  @spec find_segments([{String.t(), Layer.t()}], keyword()) ::
          {:ok, [segment()]} | {:error, Error.t()}
  def find_segments(layers, opts \\ [])

  def find_segments([], _opts),
    do: {:error, Error.new(:no_layers, "there are no layers to compare")}

  def find_segments([{_, first} | _] = layers, opts) do
    with {:ok, opts} <- Options.validate(opts, @options),
         name = opts[:attribute] || hd(first.schema.attributes).name,
         :ok <- check_attribute(layers, name) do
      tracks = Enum.flat_map(layers, fn {_, layer} -> Layer.track_names(layer) end)

      {:ok,
       for track <- tracks |> Enum.uniq() |> Enum.sort(),
           segment <- track_segments(layers, track, name, opts[:tolerance]) do
         segment
       end}
    end
  end

  defp check_attribute(layers, name) do
    case Enum.find(layers, fn {_, l} -> Schema.find_attribute(l.schema, name) == nil end) do
      nil ->
        :ok

      {who, _} ->
        {:error,
         Error.new(:unknown_attribute, "layer #{inspect(who)} has no attribute #{inspect(name)}",
           fix: "compare layers with the same schema"
         )}
    end
  end

  # Labels change at the starts and ends of annotations only.
  defp track_segments(layers, track, attribute, tolerance) do
    changes =
      for {who, layer} <- layers,
          a <- Layer.on_track(layer, track),
          a.from < a.to,
          {time, order, label} <- [{a.to, 0, nil}, {a.from, 1, a.values[attribute]}],
          do: {time, order, who, label}

    start = Map.new(layers, fn {who, _} -> {who, nil} end)

    changes
    |> Enum.sort()
    |> Enum.chunk_by(&elem(&1, 0))
    |> Enum.map_reduce(start, fn [{time, _, _, _} | _] = group, labels ->
      labels =
        Enum.reduce(group, labels, fn {_, _, who, label}, all -> Map.put(all, who, label) end)

      {{time, labels}, labels}
    end)
    |> elem(0)
    |> pair_times(track)
    |> smooth_short(tolerance)
    |> Enum.filter(fn s -> Enum.any?(s.labels, fn {_, label} -> label != nil end) end)
  end

  defp pair_times(points, track) do
    for {{from, labels}, {to, _}} <- Enum.zip(points, Enum.drop(points, 1)) do
      new_segment(track, {from, to}, labels)
    end
  end

  defp new_segment(track, {from, to}, labels) do
    agree? = labels |> Map.values() |> Enum.uniq() |> length() == 1
    %{track: track, from: from, to: to, labels: labels, agree?: agree?}
  end

  # A short disagreement is divided between its neighbours, if both are agreements.
  defp smooth_short(segments, 0), do: segments

  defp smooth_short([%{agree?: true} = a, %{agree?: false} = b, %{agree?: true} = c | rest], most)
       when b.to - b.from <= most do
    middle = div(b.from + b.to, 2)
    [%{a | to: middle} | smooth_short([%{c | from: middle} | rest], most)]
  end

  # At the start or end of a track, there is only one neighbour.
  defp smooth_short([%{agree?: true} = a, %{agree?: false} = b], most) when b.to - b.from <= most,
    do: [%{a | to: div(b.from + b.to, 2)}]

  defp smooth_short([segment | rest], most), do: [segment | smooth_short(rest, most)]
  defp smooth_short([], _most), do: []

  @doc """
  Builds a layer of segments. Where all annotators agree, it has an annotation. Elsewhere it has a proposal with the
  label of most annotators, whose confidence is their share, for a review. Neighbouring segments with the same outcome
  are joined.
  """
  @spec build_layer(Schema.t(), [segment()], String.t() | nil) ::
          {:ok, Layer.t()} | {:error, Error.t()}
  def build_layer(%Schema{} = schema, segments, attribute \\ nil) do
    name = attribute || hd(schema.attributes).name

    annotations =
      for segment <- segments,
          {label, share} = choose_label(segment.labels),
          label != nil do
        values = schema |> Schema.default_values(segment.track) |> Map.put(name, label)
        more = [by: "consensus", confidence: share, proposed?: not segment.agree?]
        Annotation.new(segment.from, segment.to, segment.track, values, more)
      end

    annotations |> join_neighbours() |> then(&Layer.new(schema, &1))
  end

  # If as many annotators have no label as have one, the label is proposed.
  defp choose_label(labels) do
    counts = labels |> Map.values() |> Enum.frequencies()
    {label, count} = Enum.max_by(counts, fn {label, count} -> {count, label != nil, label} end)
    {label, count / map_size(labels)}
  end

  defp join_neighbours([a, b | rest]) do
    if a.track == b.track and a.to == b.from and %{a | from: b.from, to: b.to} == b,
      do: join_neighbours([%{a | to: b.to} | rest]),
      else: [a | join_neighbours([b | rest])]
  end

  defp join_neighbours(annotations), do: annotations
end
