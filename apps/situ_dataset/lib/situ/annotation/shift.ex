defmodule Situ.Annotation.Shift do
  @moduledoc """
  Edits that move annotations in time: single ones, or everything from a time on (ripple edits). The children of an
  annotation move along. Each returns `{:ok, layer, transaction}` and can be undone in one step.

      iex> alias Situ.Annotation.{Layer, Schema, Shift}
      iex> spans = for t <- [0, 10, 20], do: Situ.Annotation.new(t, t + 8, "P1")
      iex> {:ok, layer} = Layer.new(Schema.text("Words"), spans)
      iex> {:ok, layer, _} = Shift.shift_after(layer, 10, 5)
      iex> for a <- Layer.annotations(layer), do: {a.from, a.to}
      [{0, 8}, {15, 23}, {25, 33}]
      iex> {:ok, layer, _} = Shift.ripple_edge(layer, 1, :to, 4)
      iex> for a <- Layer.annotations(layer), do: {a.from, a.to}
      [{0, 4}, {11, 19}, {21, 29}]
      iex> {:ok, layer, _} = Shift.close_gap(layer, 2)
      iex> for a <- Layer.annotations(layer), do: {a.from, a.to}
      [{0, 4}, {13, 21}]
  """
  alias Situ.Annotation
  alias Situ.Annotation.{Layer, Schema, Tier}
  alias Situ.Error

  @doc "Moves annotations by a duration (ns; negative: to earlier times). Errors: `:overlap`, `:bad_tier`."
  @spec shift_annotations(Layer.t(), [Layer.id()], integer()) :: Layer.edited()
  def shift_annotations(%Layer{} = layer, ids, by) do
    ids
    |> Enum.reduce_while({:ok, []}, fn id, {:ok, found} ->
      case Layer.fetch(layer, id) do
        {:ok, annotation} -> {:cont, {:ok, [annotation | found]}}
        error -> {:halt, error}
      end
    end)
    |> case do
      {:ok, annotations} -> Layer.commit(layer, shift_all(annotations, by))
      error -> error
    end
  end

  defp shift_all(annotations, by),
    do: for(a <- annotations, do: {a.id, a, %{a | from: a.from + by, to: a.to + by}})

  @doc """
  Moves all annotations that begin at or after `time` by a duration. `tracks` limits this to tracks and the tiers that
  depend on them. Error: `:overlap` if they would reach earlier annotations.
  """
  @spec shift_after(Layer.t(), Situ.Time.t(), integer(), :all | [String.t()]) :: Layer.edited()
  def shift_after(%Layer{} = layer, time, by, tracks \\ :all) do
    later =
      for track <- root_tracks(layer, tracks),
          a <- Layer.on_track(layer, track),
          a.from >= time,
          do: a

    Layer.commit(layer, shift_all(later, by))
  end

  defp root_tracks(layer, :all), do: root_tracks(layer, Layer.track_names(layer))

  defp root_tracks(layer, tracks),
    do: tracks |> Enum.map(&Tier.root_track(layer.schema.tiers, &1)) |> Enum.uniq()

  @doc """
  Moves one end of an annotation, and everything on its track that is beyond this end by the same duration. Errors:
  `:bad_edge` if the annotation would end before it begins, `:overlap`, and `:no_parent` for a child tier.
  """
  @spec ripple_edge(Layer.t(), Layer.id(), :from | :to, Situ.Time.t()) :: Layer.edited()
  def ripple_edge(%Layer{} = layer, id, edge, time) when edge in [:from, :to] do
    with {:ok, annotation} <- Layer.fetch(layer, id),
         :ok <- check_root(layer, annotation),
         :ok <- check_edge(annotation, edge, time) do
      by = time - Map.fetch!(annotation, edge)

      others =
        Enum.filter(Layer.on_track(layer, annotation.track), &beyond?(&1, annotation, edge))

      changed = {id, annotation, Map.put(annotation, edge, time)}
      Layer.commit(layer, [changed | shift_all(others, by)])
    end
  end

  defp beyond?(other, annotation, :to),
    do: other.id != annotation.id and other.from >= annotation.to

  defp beyond?(other, annotation, :from),
    do: other.id != annotation.id and other.to <= annotation.from

  @doc "Deletes an annotation, and moves the later ones of its track by its duration to earlier times."
  @spec close_gap(Layer.t(), Layer.id()) :: Layer.edited()
  def close_gap(%Layer{} = layer, id) do
    with {:ok, annotation} <- Layer.fetch(layer, id), :ok <- check_root(layer, annotation) do
      later = Enum.filter(Layer.on_track(layer, annotation.track), &beyond?(&1, annotation, :to))
      by = -Annotation.duration(annotation)
      Layer.commit(layer, [{id, annotation, nil} | shift_all(later, by)])
    end
  end

  defp check_root(layer, annotation) do
    case Schema.find_tier(layer.schema, annotation.track) do
      %{parent: parent} when parent != nil ->
        {:error,
         Error.new(
           :no_parent,
           "cannot move all later annotations of #{inspect(annotation.track)}",
           why: "they depend on annotations of #{inspect(parent)}",
           fix: "move the annotations of #{inspect(parent)}: their children move along"
         )}

      _ ->
        :ok
    end
  end

  defp check_edge(%{to: to}, :from, time) when time > to, do: edge_error()
  defp check_edge(%{from: from}, :to, time) when time < from, do: edge_error()
  defp check_edge(_annotation, _edge, _time), do: :ok

  defp edge_error do
    {:error,
     Error.new(:bad_edge, "the annotation would end before it begins",
       fix: "move the edge to the other side of its other end"
     )}
  end
end
