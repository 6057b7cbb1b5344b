defmodule Situ.Annotation.Layer do
  @moduledoc """
  Holds the annotations of one stream as a value. Every edit keeps the rules below and can be undone.

      iex> alias Situ.Annotation.{Layer, Schema}
      iex> {:ok, layer} = Layer.new(Schema.finite("Speech", ["speaks", "laughs"]))
      iex> {:ok, layer, _} = Layer.add(layer, Situ.Annotation.new(0, 10, "P1"))
      iex> {:error, error} = Layer.add(layer, Situ.Annotation.new(5, 15, "P1"))
      iex> error.code
      :overlap
      iex> {:ok, layer, edit} = Layer.set_value(layer, 1, "Speech", "laughs")
      iex> Layer.fetch!(layer, 1).values
      %{"Speech" => "laughs"}
      iex> {:ok, layer} = Layer.apply_transaction(layer, Layer.invert_transaction(edit))
      iex> Layer.fetch!(layer, 1).values
      %{"Speech" => "speaks"}

  The rules are: an annotation does not end before it begins, its values fit the schema, annotations of one track do not
  overlap (`Situ.Annotation.overlap?/2`), and annotations of a child tier fit their parents (`Situ.Annotation.Schema`).
  An edit of a parent also changes its children: they are deleted, clipped or moved along.

  A transaction is a list of `{id, before, after}`; `nil` means that the annotation does not exist. Edits return
  `{:ok, layer, transaction}`. `apply_transaction/2` applies a transaction, and `invert_transaction/1` reverses it.
  """
  alias Situ.{Annotation, Error}
  alias Situ.Annotation.{Review, Schema, TierRules, TrackTree}

  @enforce_keys [:schema]
  defstruct [:schema, by_id: %{}, tracks: %{}, next: 1, review: %{}]

  @type id :: pos_integer()
  @type transaction :: [{id(), Annotation.t() | nil, Annotation.t() | nil}]
  @type t :: %__MODULE__{
          schema: Schema.t(),
          by_id: %{id() => Annotation.t()},
          tracks: %{String.t() => :gb_trees.tree({Situ.Time.t(), Situ.Time.t()}, id())},
          next: id(),
          review: Review.t()
        }
  @type edited :: {:ok, t(), transaction()} | {:error, Error.t()}

  @doc """
  Builds a layer; annotations without an id get one. `review` is the outcome of an earlier review. Errors: the errors of
  edits.
  """
  @spec new(Schema.t(), [Annotation.t()], Review.t()) :: {:ok, t()} | {:error, Error.t()}
  def new(%Schema{} = schema, annotations \\ [], review \\ %{}) do
    # Repeated ids are replaced by new ones.
    {numbered, _} =
      Enum.map_reduce(annotations, MapSet.new(), fn a, seen ->
        if a.id in seen, do: {%{a | id: nil}, seen}, else: {a, MapSet.put(seen, a.id)}
      end)

    # The id of a rejected proposal is not used again.
    ids = Enum.map(numbered, &(&1.id || 0)) ++ Map.keys(review)
    layer = %__MODULE__{schema: schema, next: Enum.max(ids, fn -> 0 end) + 1}

    # Tiers are checked when all annotations are there, because a child may be listed before its parent.
    Enum.reduce_while(numbered, {:ok, layer}, fn annotation, {:ok, layer} ->
      id = annotation.id || layer.next

      case insert_new({id, nil, put_defaults(layer, %{annotation | id: id})}, {:ok, layer}) do
        {:cont, result} -> {:cont, result}
        {:halt, error} -> {:halt, error}
      end
    end)
    |> case do
      {:ok, layer} ->
        with :ok <- TierRules.check_layer(layer), do: {:ok, %{layer | review: review}}

      error ->
        error
    end
  end

  # The following functions are queries.

  @doc "Returns all annotations, sorted by end, then start, then track."
  @spec annotations(t()) :: [Annotation.t()]
  def annotations(%__MODULE__{} = layer),
    do: layer.by_id |> Map.values() |> Enum.sort_by(&{&1.to, &1.from, &1.track})

  @doc "Returns the sorted names of the tracks that have annotations."
  @spec track_names(t()) :: [String.t()]
  def track_names(%__MODULE__{} = layer), do: layer.tracks |> Map.keys() |> Enum.sort()

  @doc "Returns the annotations of a track in the order of time."
  @spec on_track(t(), String.t()) :: [Annotation.t()]
  def on_track(%__MODULE__{} = layer, track) do
    for id <- :gb_trees.values(track_tree(layer, track)), do: Map.fetch!(layer.by_id, id)
  end

  @doc """
  Returns the annotation of a track at `time`, or `nil`. Both ends are included; if two annotations touch at `time`,
  the later one is returned.
  """
  @spec annotation_at(t(), String.t(), Situ.Time.t()) :: Annotation.t() | nil
  def annotation_at(%__MODULE__{} = layer, track, time) do
    # Finds the last annotation that begins at or before `time`.
    case previous_annotation(layer, track, time + 1) do
      nil -> nil
      annotation -> if Annotation.contains?(annotation, time), do: annotation
    end
  end

  @doc "Returns the last annotation of a track that begins before `time`, or `nil`."
  @spec previous_annotation(t(), String.t(), Situ.Time.t()) :: Annotation.t() | nil
  def previous_annotation(%__MODULE__{} = layer, track, time),
    do: TrackTree.find_before(layer, track, time)

  @doc "Returns the first annotation of a track that begins after `time`, or `nil`."
  @spec next_annotation(t(), String.t(), Situ.Time.t()) :: Annotation.t() | nil
  def next_annotation(%__MODULE__{} = layer, track, time) do
    case :gb_trees.next(:gb_trees.iterator_from({time + 1, time + 1}, track_tree(layer, track))) do
      {_, id, _} -> Map.fetch!(layer.by_id, id)
      :none -> nil
    end
  end

  @doc "Returns the annotation with that id. Error: `:no_annotation`."
  @spec fetch(t(), id()) :: {:ok, Annotation.t()} | {:error, Error.t()}
  def fetch(%__MODULE__{} = layer, id) do
    case layer.by_id do
      %{^id => annotation} ->
        {:ok, annotation}

      _ ->
        {:error,
         Error.new(:no_annotation, "annotation #{inspect(id)} does not exist",
           fix: "reload the annotations; it may have been deleted"
         )}
    end
  end

  @doc "Returns the annotation with that id, or raises the error."
  @spec fetch!(t(), id()) :: Annotation.t()
  def fetch!(layer, id) do
    case fetch(layer, id) do
      {:ok, annotation} -> annotation
      {:error, error} -> raise error
    end
  end

  @doc "Returns the annotations of a track that share time with a span, in the order of time."
  @spec between(t(), String.t(), Situ.Time.t(), Situ.Time.t()) :: [Annotation.t()]
  def between(%__MODULE__{} = layer, track, from, to),
    do: TrackTree.list_between(layer, track, from, to)

  defp track_tree(layer, track), do: Map.get(layer.tracks, track, :gb_trees.empty())

  # The following functions are edits.

  @doc "Adds an annotation with a new id; missing attributes get their default values."
  @spec add(t(), Annotation.t()) :: edited()
  def add(%__MODULE__{} = layer, %Annotation{} = annotation) do
    annotation = put_defaults(layer, %{annotation | id: layer.next})
    commit(layer, [{layer.next, nil, annotation}])
  end

  defp put_defaults(layer, annotation),
    do: %{
      annotation
      | values:
          Map.merge(Schema.default_values(layer.schema, annotation.track), annotation.values)
    }

  @doc "Deletes all of these annotations, or none if one does not exist."
  @spec remove(t(), id() | [id()]) :: edited()
  def remove(%__MODULE__{} = layer, ids) do
    ids
    |> List.wrap()
    |> Enum.reduce_while({:ok, []}, fn id, {:ok, changes} ->
      case fetch(layer, id) do
        {:ok, annotation} -> {:cont, {:ok, [{id, annotation, nil} | changes]}}
        error -> {:halt, error}
      end
    end)
    |> case do
      {:ok, changes} -> commit(layer, changes)
      error -> error
    end
  end

  @doc """
  Changes fields of an annotation: `from:`, `to:`, `track:`, `values:`, `by:`, `confidence:`, `note:`, `proposed?:`.
  """
  @spec change(t(), id(), keyword()) :: edited()
  def change(%__MODULE__{} = layer, id, fields) do
    with {:ok, old} <- fetch(layer, id),
         do: commit(layer, [{id, old, %{struct!(old, fields) | id: id}}])
  end

  @doc "Sets the value of one attribute."
  @spec set_value(t(), id(), String.t(), Schema.value()) :: edited()
  def set_value(%__MODULE__{} = layer, id, attribute, value) do
    with {:ok, old} <- fetch(layer, id),
         do: change(layer, id, values: Map.put(old.values, attribute, value))
  end

  @doc """
  Returns how far the proposals have been reviewed: `total`, `reviewed`, `accepted`, `rejected` and `corrected` (the
  accepted proposals that a person has changed).

      iex> alias Situ.Annotation.{Edit, Layer, Schema}
      iex> {:ok, layer} = Layer.new(Schema.text("Words"))
      iex> spans = for t <- [0, 10, 20], do: Situ.Annotation.new(t, t + 5, "P1")
      iex> {:ok, layer, _} = Edit.add_proposals(layer, spans)
      iex> {:ok, layer, _} = Layer.accept_proposal(layer, 1)
      iex> {:ok, layer, _} = Layer.remove(layer, 2)
      iex> Layer.review_progress(layer)
      %{total: 3, reviewed: 2, accepted: 1, rejected: 1, corrected: 0}
  """
  @spec review_progress(t()) :: Review.progress()
  def review_progress(%__MODULE__{} = layer),
    do: Review.summarize(layer.review, Enum.count(layer.by_id, fn {_, a} -> a.proposed? end))

  @doc "Accepts a proposal as an annotation."
  @spec accept_proposal(t(), id(), String.t() | nil) :: edited()
  def accept_proposal(%__MODULE__{} = layer, id, by \\ nil) do
    with {:ok, old} <- fetch(layer, id), do: change(layer, id, proposed?: false, by: by || old.by)
  end

  @doc """
  Applies a transaction, together with the changes of child tiers that follow from it, and returns the complete
  transaction. Only the changed annotations are checked against the rules.
  """
  @spec commit(t(), transaction()) :: edited()
  def commit(%__MODULE__{} = layer, transaction) do
    with {:ok, transaction} <- TierRules.complete_transaction(layer, transaction),
         {:ok, layer} <- __MODULE__.apply_transaction(layer, transaction),
         do: {:ok, layer, transaction}
  end

  @doc "Joins transactions that were made one after the other into one."
  @spec join_transactions([transaction()]) :: transaction()
  def join_transactions(transactions) do
    transactions
    |> Enum.concat()
    |> Enum.group_by(&elem(&1, 0))
    |> Enum.map(fn {id, [{_, before, _} | _] = changes} ->
      {id, before, changes |> List.last() |> elem(2)}
    end)
    |> Enum.reject(fn {_, before, later} -> before == nil and later == nil end)
  end

  @doc """
  Applies a transaction completely or not at all. Errors: `:overlap`, `:bad_value`, `:unknown_attribute`,
  `:bad_annotation`, `:no_parent` and `:bad_tier` (of a child tier), and `:stale_edit` if the layer has changed since
  the transaction was made.
  """
  @spec apply_transaction(t(), transaction()) :: {:ok, t()} | {:error, Error.t()}
  def apply_transaction(%__MODULE__{} = layer, transaction) do
    with :ok <- check_current(layer, transaction) do
      bare =
        Enum.reduce(transaction, layer, fn {id, old, _}, layer -> remove_old(layer, id, old) end)

      bare = %{bare | review: Review.record_transaction(layer.review, transaction)}

      with {:ok, layer} <- Enum.reduce_while(transaction, {:ok, bare}, &insert_new/2),
           :ok <- TierRules.check_transaction(layer, transaction),
           do: {:ok, layer}
    end
  end

  defp check_current(layer, transaction) do
    if Enum.all?(transaction, fn {id, old, _} -> Map.get(layer.by_id, id) == old end) do
      :ok
    else
      {:error,
       Error.new(:stale_edit, "the annotation was changed by someone else",
         fix: "check the annotation and repeat the edit"
       )}
    end
  end

  defp remove_old(layer, _id, nil), do: layer

  defp remove_old(layer, id, old) do
    tree = :gb_trees.delete({old.from, old.to}, Map.fetch!(layer.tracks, old.track))

    tracks =
      if :gb_trees.is_empty(tree),
        do: Map.delete(layer.tracks, old.track),
        else: Map.put(layer.tracks, old.track, tree)

    %{layer | by_id: Map.delete(layer.by_id, id), tracks: tracks}
  end

  defp insert_new({_id, _old, nil}, {:ok, layer}), do: {:cont, {:ok, layer}}

  defp insert_new({id, _old, new}, {:ok, layer}) do
    with :ok <- Annotation.check_fields(new),
         :ok <- Schema.check_values(layer.schema, new.values),
         :ok <- check_free(layer, new) do
      tree = :gb_trees.insert({new.from, new.to}, id, track_tree(layer, new.track))

      {:cont,
       {:ok,
        %{
          layer
          | by_id: Map.put(layer.by_id, id, new),
            tracks: Map.put(layer.tracks, new.track, tree),
            next: max(layer.next, id + 1)
        }}}
    else
      error -> {:halt, error}
    end
  end

  # Annotations of a track do not overlap, so only the nearest ones on either side can overlap with a new one.
  defp check_free(layer, new) do
    case Enum.find(TrackTree.list_nearest(layer, new), &Annotation.overlap?(&1, new)) do
      nil -> :ok
      other -> {:error, overlap_error(new, other)}
    end
  end

  defp overlap_error(new, other) do
    Error.new(:overlap, "the annotation overlaps with another one on track #{inspect(new.track)}",
      why:
        "the other one lasts from #{Situ.Time.to_iso8601(other.from)} to #{Situ.Time.to_iso8601(other.to)}",
      fix: "move its edge, or use another track"
    )
  end

  @doc "Returns the transaction that undoes a transaction."
  @spec invert_transaction(transaction()) :: transaction()
  def invert_transaction(transaction),
    do:
      transaction |> Enum.reverse() |> Enum.map(fn {id, before, later} -> {id, later, before} end)
end
