defmodule Situ.Annotation.Edit do
  @moduledoc """
  Edits that change several annotations of a `Situ.Annotation.Layer` together: shared edges, complete tracks, splits
  and proposals. Each returns `{:ok, layer, transaction}` and can be undone in one step.

      iex> alias Situ.Annotation.{Edit, Layer, Schema}
      iex> {:ok, layer} = Layer.new(Schema.text("Words"),
      ...>   [Situ.Annotation.new(0, 10, "P1"), Situ.Annotation.new(10, 20, "P1")])
      iex> {:ok, layer, _} = Edit.move_edge(layer, 1, :to, 12)
      iex> for a <- Layer.annotations(layer), do: {a.from, a.to}
      [{0, 12}, {12, 20}]
      iex> {:ok, layer, _} = Edit.split_annotation(layer, 1, 4)
      iex> for a <- Layer.annotations(layer), do: {a.from, a.to}
      [{0, 4}, {4, 12}, {12, 20}]
  """
  alias Situ.Annotation
  alias Situ.Annotation.{Layer, Schema}
  alias Situ.Error

  @doc """
  Moves one end (`:from` or `:to`) of an annotation to `time`. A neighbour that touches this end moves along, unless
  `alone: true` is given; otherwise the edge stops at the neighbour. The edge also stops at the annotation's other
  end.

  The annotation in the returned layer shows the time that the edge was moved to.
  """
  @spec move_edge(Layer.t(), Layer.id(), :from | :to, Situ.Time.t(), keyword()) :: Layer.edited()
  def move_edge(%Layer{} = layer, id, edge, time, opts \\ []) when edge in [:from, :to] do
    with {:ok, annotation} <- Layer.fetch(layer, id) do
      touching = if opts[:alone], do: nil, else: find_touching(layer, annotation, edge)
      time = clamp_edge(layer, annotation, edge, time, touching)
      moved = [{id, annotation, Map.put(annotation, edge, time)}]

      along =
        if touching,
          do: [{touching.id, touching, Map.put(touching, opposite_edge(edge), time)}],
          else: []

      Layer.commit(layer, moved ++ along)
    end
  end

  defp opposite_edge(:from), do: :to
  defp opposite_edge(:to), do: :from

  defp find_touching(layer, annotation, edge) do
    at = Map.fetch!(annotation, edge)
    neighbour = find_neighbour(layer, annotation, edge)
    if neighbour && Map.fetch!(neighbour, opposite_edge(edge)) == at, do: neighbour
  end

  defp find_neighbour(layer, annotation, :from) do
    case Layer.previous_annotation(layer, annotation.track, annotation.from) do
      %{id: id} when id == annotation.id -> nil
      annotation -> annotation
    end
  end

  defp find_neighbour(layer, annotation, :to) do
    layer
    |> Layer.on_track(annotation.track)
    |> Enum.find(&(&1.id != annotation.id and &1.from >= annotation.to))
  end

  # When two annotations move together, neither may become a point, because both would then end together.
  defp clamp_edge(_layer, annotation, :from, time, %{from: least}),
    do: time |> min(annotation.to - 1) |> max(least + 1)

  defp clamp_edge(_layer, annotation, :to, time, %{to: most}),
    do: time |> max(annotation.from + 1) |> min(most - 1)

  defp clamp_edge(layer, annotation, :from, time, nil) do
    neighbour = find_neighbour(layer, annotation, :from)
    time |> min(annotation.to) |> then(&if(neighbour, do: max(&1, neighbour.to), else: &1))
  end

  defp clamp_edge(layer, annotation, :to, time, nil) do
    neighbour = find_neighbour(layer, annotation, :to)
    time |> max(annotation.from) |> then(&if(neighbour, do: min(&1, neighbour.from), else: &1))
  end

  @doc """
  Adds an annotation by the schema's rule for overlaps: `:refuse` returns the error `:overlap`, `:clip` shortens the new
  annotation to the first free time in its interval, and `:replace` cuts or deletes the annotations under it.

      iex> alias Situ.Annotation.{Edit, Layer, Schema}
      iex> {:ok, layer} = Layer.new(%{Schema.text("Words") | overlap: :replace}, [Situ.Annotation.new(0, 10, "P1")])
      iex> {:ok, layer, _} = Edit.annotate(layer, Situ.Annotation.new(6, 8, "P1"))
      iex> for a <- Layer.annotations(layer), do: {a.from, a.to}
      [{0, 6}, {6, 8}, {8, 10}]
  """
  @spec annotate(Layer.t(), Annotation.t()) :: Layer.edited()
  def annotate(%Layer{schema: %{overlap: rule}} = layer, %Annotation{} = new) do
    others =
      layer
      |> Layer.between(new.track, new.from, new.to)
      |> Enum.filter(&Annotation.overlap?(&1, new))

    if rule == :refuse or others == [] or divides_parent?(layer.schema, new.track),
      do: Layer.add(layer, new),
      else: annotate_over(layer, new, others, rule)
  end

  # A new annotation on such a tier divides the one under it.
  defp divides_parent?(schema, track) do
    case Schema.find_tier(schema, track) do
      %{relation: relation} -> relation not in [nil, :included_in]
      nil -> false
    end
  end

  defp annotate_over(layer, new, others, :clip) do
    from = Enum.reduce(others, new.from, &if(&1.from <= &2 and &1.to > &2, do: &1.to, else: &2))
    to = for(a <- others, a.from > from, do: a.from) |> Enum.min(fn -> new.to end)

    if from < to,
      do: Layer.add(layer, %{new | from: from, to: min(to, new.to)}),
      else: Layer.add(layer, new)
  end

  defp annotate_over(layer, new, others, :replace) do
    {cuts, next} = Enum.flat_map_reduce(others, layer.next, &cut_annotation(&1, new, &2))
    values = Map.merge(Schema.default_values(layer.schema, new.track), new.values)
    Layer.commit(layer, cuts ++ [{next, nil, %{new | id: next, values: values}}])
  end

  defp cut_annotation(old, new, next) do
    before = if old.from < new.from, do: %{old | to: new.from}
    later = if old.to > new.to, do: %{old | from: new.to}

    case {before, later} do
      {nil, later} -> {[{old.id, old, later}], next}
      {before, nil} -> {[{old.id, old, before}], next}
      {_, later} -> {[{old.id, old, before}, {next, nil, %{later | id: next}}], next + 1}
    end
  end

  @doc "Sets the interval of an annotation. Error: `:overlap`."
  @spec set_interval(Layer.t(), Layer.id(), {Situ.Time.t(), Situ.Time.t()}) :: Layer.edited()
  def set_interval(%Layer{} = layer, id, {from, to}),
    do: Layer.change(layer, id, from: from, to: to)

  @doc "Splits an annotation in two at `time`; both parts keep its values. Error: `:outside`."
  @spec split_annotation(Layer.t(), Layer.id(), Situ.Time.t()) :: Layer.edited()
  def split_annotation(%Layer{} = layer, id, time) do
    with {:ok, annotation} <- Layer.fetch(layer, id) do
      if annotation.from < time and time < annotation.to do
        second = %{annotation | id: layer.next, from: time}

        Layer.commit(layer, [{id, annotation, %{annotation | to: time}}, {second.id, nil, second}])
      else
        {:error,
         Error.new(:outside, "cannot split an annotation outside its interval",
           why:
             "it lasts from #{annotation.from} to #{annotation.to}, and #{time} is not between these times",
           fix: "move the cursor into the annotation"
         )}
      end
    end
  end

  @doc "Merges two annotations of a track into one with the values of the first. Error: `:no_neighbours`."
  @spec merge_annotations(Layer.t(), Layer.id(), Layer.id()) :: Layer.edited()
  def merge_annotations(%Layer{} = layer, id, other) do
    with {:ok, a} <- Layer.fetch(layer, id), {:ok, b} <- Layer.fetch(layer, other) do
      if a.track == b.track and a.id != b.id do
        annotation = %{a | from: min(a.from, b.from), to: max(a.to, b.to)}
        Layer.commit(layer, [{other, b, nil}, {id, a, annotation}])
      else
        {:error,
         Error.new(:no_neighbours, "cannot merge annotations of different tracks",
           why: "these are on #{inspect(a.track)} and #{inspect(b.track)}",
           fix: "move either annotation to the other's track"
         )}
      end
    end
  end

  @doc "Renames a track. Error: `:overlap` if a track of that name has annotations that overlap."
  @spec rename_track(Layer.t(), String.t(), String.t()) :: Layer.edited()
  def rename_track(%Layer{} = layer, from, to) do
    Layer.commit(layer, for(a <- Layer.on_track(layer, from), do: {a.id, a, %{a | track: to}}))
  end

  @doc "Deletes all annotations of a track."
  @spec delete_track(Layer.t(), String.t()) :: Layer.edited()
  def delete_track(%Layer{} = layer, track),
    do: Layer.remove(layer, Enum.map(Layer.on_track(layer, track), & &1.id))

  @doc """
  Copies the intervals of other annotations to an empty track, with default values. Error: `:not_empty`.
  """
  @spec copy_boundaries(Layer.t(), [Annotation.t()], String.t()) :: Layer.edited()
  def copy_boundaries(%Layer{} = layer, annotations, track) do
    case Layer.on_track(layer, track) do
      [] ->
        values = Schema.default_values(layer.schema)

        new =
          for {a, id} <- Enum.with_index(annotations, layer.next),
              do:
                {id, nil,
                 %Annotation{id: id, from: a.from, to: a.to, track: track, values: values}}

        Layer.commit(layer, new)

      some ->
        {:error,
         Error.new(:not_empty, "track #{inspect(track)} already has #{length(some)} annotations",
           fix: "copy to a new track, or delete them first"
         )}
    end
  end

  @doc "Accepts every proposal whose confidence is at least `least`; a missing confidence counts as 1.0."
  @spec accept_all(Layer.t(), float(), String.t() | nil) :: Layer.edited()
  def accept_all(%Layer{} = layer, least \\ 0.0, by \\ nil) do
    accepted =
      for a <- Layer.annotations(layer),
          a.proposed? and (a.confidence || 1.0) >= least,
          do: {a.id, a, %{a | proposed?: false, by: by || a.by}}

    Layer.commit(layer, accepted)
  end

  @doc "Deletes every proposal whose confidence is below `most`; a missing confidence counts as 1.0."
  @spec reject_all(Layer.t(), float()) :: Layer.edited()
  def reject_all(%Layer{} = layer, most) do
    ids =
      for a <- Layer.annotations(layer), a.proposed? and (a.confidence || 1.0) < most, do: a.id

    Layer.remove(layer, ids)
  end

  @doc "Adds annotations as proposals in one transaction; annotations that overlap with existing ones are skipped."
  @spec add_proposals(Layer.t(), [Annotation.t()]) :: Layer.edited()
  def add_proposals(%Layer{} = layer, annotations) do
    {full, changes} =
      Enum.reduce(annotations, {layer, []}, fn annotation, {layer, changes} ->
        case Layer.add(layer, %{annotation | proposed?: true}) do
          {:ok, layer, change} -> {layer, [change | changes]}
          {:error, _} -> {layer, changes}
        end
      end)

    {:ok, full, changes |> Enum.reverse() |> Layer.join_transactions()}
  end
end
