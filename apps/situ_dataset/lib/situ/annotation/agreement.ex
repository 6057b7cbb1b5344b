defmodule Situ.Annotation.Agreement do
  @moduledoc """
  Measures how well two annotators agree: Cohen's kappa over frames, and the distance between their boundaries.

  Every track is divided into frames. An annotator's label of a frame is the value of the annotation at the middle of
  the frame; a frame without an annotation counts as a separate label. With `p_o` the share of frames with equal
  labels and `p_e` the share expected by chance from how often each annotator uses each label,

      kappa = (p_o - p_e) / (1 - p_e)

  (J. Cohen, *A coefficient of agreement for nominal scales*, Educational and Psychological Measurement 20, 1960). A
  kappa of 1 means full agreement, and 0 means no more agreement than by chance. Kappa is undefined (`nil`) if both
  annotators use the same single label throughout, because chance explains all the agreement.

  Annotations are paired by their largest overlap on a track; the differences of their start and end times are the
  boundary errors.

      iex> alias Situ.Annotation.{Agreement, Layer, Schema}
      iex> schema = Schema.finite("S", ["speaks"])
      iex> {:ok, a} = Layer.new(schema, [Situ.Annotation.new(0, 60, "P1")])
      iex> {:ok, b} = Layer.new(schema, [Situ.Annotation.new(10, 60, "P1")])
      iex> {:ok, r} = Agreement.compare_layers(a, b, frame: 10, to: 100)
      iex> {r.agreement, Float.round(r.kappa, 3), r.begin_error, r.end_error, r.paired, r.only_first}
      {0.9, 0.8, 10.0, 0.0, 1, 0}
  """

  @options [
    attribute: [type: :string, doc: "The attribute to compare. Default: the first of the schema."],
    frame: [
      type: :pos_integer,
      default: 10_000_000,
      doc: "Time (ns) between the instants at which labels are compared."
    ],
    from: [
      type: :integer,
      doc: "Start of the span. Default: the start of the first annotation of both layers."
    ],
    to: [
      type: :integer,
      doc: "End of the span (excluded). Default: the end of the last annotation of both layers."
    ],
    tracks: [
      type: {:list, :string},
      doc: "The tracks to compare. Default: all tracks of both layers."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @options)

  alias Situ.Annotation
  alias Situ.Annotation.Layer
  alias Situ.{Error, Options}

  @most_frames 100_000_000

  @type t :: %{
          attribute: String.t(),
          frames: non_neg_integer(),
          agreement: float() | nil,
          kappa: float() | nil,
          confusion: %{{label(), label()} => pos_integer()},
          paired: non_neg_integer(),
          only_first: non_neg_integer(),
          only_second: non_neg_integer(),
          begin_error: float() | nil,
          end_error: float() | nil,
          tracks: %{String.t() => float() | nil}
        }
  @type label :: term() | nil

  @doc """
  Compares two layers. `confusion` counts frames by `{label_of_first, label_of_second}`. `begin_error` and `end_error`
  are mean absolute differences in ns over the paired annotations. `tracks` maps each track to its kappa.

  Errors: `:unknown_attribute`; `:too_many_frames`.
  """
  @spec compare_layers(Layer.t(), Layer.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def compare_layers(%Layer{} = a, %Layer{} = b, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @options),
         {:ok, attribute} <- resolve_attribute(a, b, opts[:attribute]),
         tracks = opts[:tracks] || Enum.uniq(Layer.track_names(a) ++ Layer.track_names(b)),
         span = resolve_span(a, b, opts),
         :ok <- check_frame_count(span, opts[:frame], length(tracks)) do
      confusions =
        Map.new(tracks, &{&1, count_confusion(a, b, &1, attribute, span, opts[:frame])})

      confusion =
        confusions
        |> Map.values()
        |> Enum.reduce(%{}, &Map.merge(&1, &2, fn _, m, n -> m + n end))

      {agreement, kappa} = kappa(confusion)

      {:ok,
       %{
         attribute: attribute,
         frames: confusion |> Map.values() |> Enum.sum(),
         agreement: agreement,
         kappa: kappa,
         confusion: confusion,
         tracks: Map.new(confusions, fn {track, c} -> {track, elem(kappa(c), 1)} end)
       }
       |> Map.merge(boundary_errors(a, b, tracks))}
    end
  end

  defp resolve_attribute(a, b, nil), do: resolve_attribute(a, b, hd(a.schema.attributes).name)

  defp resolve_attribute(a, b, name) do
    case Enum.find([a, b], &(Situ.Annotation.Schema.find_attribute(&1.schema, name) == nil)) do
      nil ->
        {:ok, name}

      layer ->
        {:error,
         Error.new(
           :unknown_attribute,
           "schema #{inspect(layer.schema.name)} has no attribute #{inspect(name)}",
           fix: "use one of #{Enum.map_join(layer.schema.attributes, ", ", &inspect(&1.name))}"
         )}
    end
  end

  defp resolve_span(a, b, opts) do
    all = Layer.annotations(a) ++ Layer.annotations(b)
    from = opts[:from] || all |> Enum.map(& &1.from) |> Enum.min(fn -> 0 end)
    to = opts[:to] || all |> Enum.map(& &1.to) |> Enum.max(fn -> 0 end)
    {from, max(from, to)}
  end

  defp check_frame_count({from, to}, frame, tracks) do
    n = div(to - from, frame) * max(tracks, 1)

    if n <= @most_frames do
      :ok
    else
      {:error,
       Error.new(:too_many_frames, "the comparison would need #{n} frames",
         why: "at most #{@most_frames} frames are compared",
         fix: "set a longer frame: or a shorter span with from: and to:"
       )}
    end
  end

  # The labels are constant between changes of either layer, so the cost depends on the number of annotations and not
  # on the number of frames. A frame belongs to the run that contains its middle.
  defp count_confusion(a, b, track, attribute, {from, to}, frame) do
    one = label_segments(Layer.on_track(a, track), attribute, from, to)
    two = label_segments(Layer.on_track(b, track), attribute, from, to)

    {counts, _} =
      Enum.reduce(merge_segments(one, two), {%{}, 0}, fn {end_time, pair}, {counts, seen} ->
        n = middles_before(end_time, from, to, frame)
        {if(n > seen, do: Map.update(counts, pair, n - seen, &(&1 + n - seen)), else: counts), n}
      end)

    counts
  end

  # Consecutive `{end, label}` tuples from `from` to `to`; the label is nil where there is no annotation.
  defp label_segments(annotations, attribute, from, to) do
    {pieces, at} =
      annotations
      |> Enum.filter(&(&1.to > from and &1.from < to and &1.from < &1.to))
      |> Enum.flat_map_reduce(from, fn a, at ->
        label = a.values[attribute]
        gap = if a.from > at, do: [{a.from, nil}], else: []
        {gap ++ [{min(a.to, to), {:label, label}}], min(a.to, to)}
      end)

    if at < to, do: pieces ++ [{to, nil}], else: pieces
  end

  defp merge_segments([{a_end, a} | one] = left, [{b_end, b} | two] = right) do
    cond do
      a_end < b_end -> [{a_end, label_pair(a, b)} | merge_segments(one, right)]
      a_end > b_end -> [{b_end, label_pair(a, b)} | merge_segments(left, two)]
      true -> [{a_end, label_pair(a, b)} | merge_segments(one, two)]
    end
  end

  defp merge_segments(_, _), do: []

  defp label_pair(a, b), do: {unwrap_label(a), unwrap_label(b)}
  defp unwrap_label(nil), do: nil
  defp unwrap_label({:label, value}), do: value

  # The middle of frame k is at from + k * frame + frame / 2; only complete frames count.
  defp middles_before(time, from, to, frame) do
    whole = div(to - from, frame)
    n = div(2 * (time - from) + frame - 1, 2 * frame)
    min(max(n, 0), whole)
  end

  @doc """
  Returns the share of agreement and the kappa of a table `%{{first, second} => count}`. Undefined values are `nil`.

      iex> {0.7, kappa} = Situ.Annotation.Agreement.kappa(%{{1, 1} => 20, {1, 0} => 5, {0, 1} => 10, {0, 0} => 15})
      iex> Float.round(kappa, 6)
      0.4
  """
  @spec kappa(%{{label(), label()} => pos_integer()}) :: {float() | nil, float() | nil}
  def kappa(confusion) do
    case confusion |> Map.values() |> Enum.sum() do
      0 ->
        {nil, nil}

      n ->
        same = for({{l, l}, count} <- confusion, do: count) |> Enum.sum()
        first = label_totals(confusion, 0)
        second = label_totals(confusion, 1)

        chance =
          first |> Enum.map(fn {l, count} -> count * Map.get(second, l, 0) end) |> Enum.sum()

        observed = same / n
        # Integer arithmetic decides exactly whether chance explains all the agreement.
        {observed,
         if(chance == n * n, do: nil, else: (observed - chance / (n * n)) / (1 - chance / (n * n)))}
    end
  end

  defp label_totals(confusion, side) do
    Enum.reduce(confusion, %{}, fn {labels, count}, totals ->
      Map.update(totals, elem(labels, side), count, &(&1 + count))
    end)
  end

  defp boundary_errors(a, b, tracks) do
    per_track =
      for track <- tracks, do: {track, Layer.on_track(a, track), Layer.on_track(b, track)}

    pairs = Enum.flat_map(per_track, fn {_, left, right} -> pair_annotations(left, right) end)
    count = fn side -> per_track |> Enum.map(&length(elem(&1, side))) |> Enum.sum() end

    %{
      paired: length(pairs),
      only_first: count.(1) - length(pairs),
      only_second: count.(2) - length(pairs),
      begin_error: mean(for {x, y} <- pairs, do: abs(x.from - y.from)),
      end_error: mean(for {x, y} <- pairs, do: abs(x.to - y.to))
    }
  end

  # Pairs the widest overlaps first, so that each annotation is in at most one pair.
  defp pair_annotations(left, right) do
    candidates =
      for x <- left,
          y <- list_overlapping(right, x),
          do: {overlap_duration(x, y), x, y}

    {pairs, _, _} =
      candidates
      |> Enum.sort_by(fn {width, x, y} -> {-width, x.from, y.from} end)
      |> Enum.reduce({[], MapSet.new(), MapSet.new()}, fn {_, x, y}, {pairs, xs, ys} ->
        if x.id in xs or y.id in ys,
          do: {pairs, xs, ys},
          else: {[{x, y} | pairs], MapSet.put(xs, x.id), MapSet.put(ys, y.id)}
      end)

    pairs
  end

  defp list_overlapping(annotations, x) do
    annotations
    |> Enum.drop_while(&(&1.to < x.from))
    |> Enum.take_while(&(&1.from <= x.to))
    |> Enum.filter(&(overlap_duration(x, &1) > 0 or (x.from == &1.from and x.to == &1.to)))
  end

  defp overlap_duration(%Annotation{} = x, %Annotation{} = y),
    do: min(x.to, y.to) - max(x.from, y.from)

  defp mean([]), do: nil
  defp mean(list), do: Enum.sum(list) / length(list)
end
