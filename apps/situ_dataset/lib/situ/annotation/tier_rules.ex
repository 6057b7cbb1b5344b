defmodule Situ.Annotation.TierRules do
  @moduledoc false
  # Keeps the annotations of child tiers consistent with their parents. `complete_transaction/2` adds the changes that
  # follow from an edit: children of a deleted annotation are deleted, children of a moved one move along, and a
  # subdivision always fills its parent. `check_transaction/2` checks a transaction that is complete, such as an entry
  # of a log.
  # See docs/adr/0192-the-parent-of-an-annotation-follows-from-its-time.md.
  alias Situ.Annotation
  alias Situ.Annotation.{Tier, TrackTree}
  alias Situ.Error

  @typedoc "A `Situ.Annotation.Layer`, which uses this module."
  @type layer :: %{
          :schema => Situ.Annotation.Schema.t(),
          :by_id => %{pos_integer() => Annotation.t()},
          :tracks => map(),
          optional(atom()) => term()
        }
  @type transaction :: [{pos_integer(), Annotation.t() | nil, Annotation.t() | nil}]
  @typep changes :: %{pos_integer() => {Annotation.t() | nil, Annotation.t() | nil}}

  @doc "Adds the changes on child tiers. Error: `:no_parent`."
  @spec complete_transaction(layer(), transaction()) ::
          {:ok, transaction()} | {:error, Error.t()}
  def complete_transaction(%{schema: %{tiers: []}}, transaction), do: {:ok, transaction}

  def complete_transaction(%{} = layer, transaction) do
    changes = Map.new(transaction, fn {id, before, later} -> {id, {before, later}} end)
    explicit = changes |> Map.keys() |> MapSet.new()

    changes
    |> touched_roots(layer.schema.tiers)
    |> Enum.reduce(changes, &settle_children(&2, &1, layer, explicit))
    |> Enum.sort()
    |> Enum.filter(fn {id, {before, later}} -> before != later or id in explicit end)
    |> then(&{:ok, for({id, {before, later}} <- &1, do: {id, before, later})})
  catch
    {:error, %Error{}} = error -> error
  end

  defp touched_roots(changes, tiers) do
    for({_, {a, b}} <- changes, %{track: track} <- [a, b], do: Tier.root_track(tiers, track))
    |> Enum.uniq()
  end

  defp settle_children(changes, parent_track, layer, explicit) do
    layer.schema.tiers
    |> Tier.child_tiers(parent_track)
    |> Enum.reduce(changes, fn tier, changes ->
      changes
      |> settle_tier(tier, layer, explicit)
      |> settle_children(tier.name, layer, explicit)
    end)
  end

  # Assigns every affected child to the parent that it shares most time with, and fits each family to its parent.
  defp settle_tier(changes, tier, layer, explicit) do
    changed_parents = changes_on(changes, tier.parent)
    own? = changes_on(changes, tier.name) != []

    # Children that only move along with their parents already fit them.
    {moved, changed_parents} =
      Enum.split_with(changed_parents, fn {_, {old, new}} -> not own? and shifted?(old, new) end)

    orphans = for {_, {%{} = old, new}} <- changed_parents, do: {old, new}
    changes = Enum.reduce(orphans, changes, &move_along(&2, &1, tier, layer))
    children = for {id, {_, %{track: track} = a}} <- changes, track == tier.name, do: {id, a}
    removed = for {_, {%{track: t} = a, nil}} <- changes, t == tier.name, do: a

    changes =
      Enum.reduce(moved, changes, fn {_, pair}, all -> move_along(all, pair, tier, layer) end)

    {changes, parents} =
      Enum.reduce(children, {changes, []}, fn {id, child}, {changes, parents} ->
        assign_child(changes, parents, {id, child, tier}, {layer, explicit})
      end)

    parents =
      parents ++
        for(a <- removed, do: find_parent(changes, layer, tier, a)) ++
        for {_, {_, %{track: track} = new}} <- changed_parents, track == tier.parent, do: new

    parents
    |> Enum.reject(&is_nil/1)
    |> Enum.uniq_by(& &1.id)
    |> Enum.reduce(changes, &fit_family(&2, &1, tier, {layer, explicit}))
  end

  defp changes_on(changes, track) do
    Enum.filter(changes, fn {_, {a, b}} ->
      (a != nil and a.track == track) or (b != nil and b.track == track)
    end)
  end

  # The children of a changed parent become part of the edit. If the parent was only moved, they move with it.
  defp move_along(changes, {old, new}, tier, layer) do
    by = if shifted?(old, new), do: new.from - old.from, else: 0

    for child <- list_between(layer, tier.name, old),
        not is_map_key(changes, child.id),
        into: changes do
      track = target_track(layer, tier, {old, new})
      {child.id, {child, %{child | from: child.from + by, to: child.to + by, track: track}}}
    end
  end

  defp shifted?(old, new) when old == nil or new == nil, do: false
  defp shifted?(old, new), do: old.to - old.from == new.to - new.from

  # The children of an annotation that moves to another track move to the same tier below that track.
  defp target_track(layer, tier, {%{track: track}, %{track: other}}) when track != other do
    layer.schema.tiers
    |> Tier.child_tiers(other)
    |> Enum.find(&(&1.attribute == tier.attribute and &1.relation == tier.relation))
    |> case do
      nil -> throw({:error, no_tier_error(tier, other)})
      %{name: name} -> name
    end
  end

  defp target_track(_layer, tier, _), do: tier.name

  defp assign_child(changes, parents, {id, child, tier}, {layer, explicit}) do
    case find_parent(changes, layer, tier, child) do
      %{} = parent ->
        {changes, [parent | parents]}

      nil ->
        if id in explicit, do: throw({:error, no_parent_error(tier, child)})
        {before, _} = Map.fetch!(changes, id)
        {Map.put(changes, id, {before, nil}), parents}
    end
  end

  # Returns the parent annotation that shares most time with an annotation, after the changes.
  defp find_parent(changes, layer, tier, child) do
    changes
    |> current_between(layer, tier.parent, child)
    |> Enum.max_by(&shared_time(&1, child), fn -> nil end)
  end

  defp shared_time(a, b), do: min(a.to, b.to) - max(a.from, b.from)

  @spec current_between(changes(), layer(), String.t(), Annotation.t()) :: [Annotation.t()]
  defp current_between(changes, layer, track, span) do
    same = for a <- list_between(layer, track, span), not is_map_key(changes, a.id), do: a

    changed = for {_, {_, %{track: ^track} = a}} <- changes, shared_time(a, span) > 0, do: a

    same ++ changed
  end

  defp list_between(layer, track, %{from: from, to: to}),
    do:
      layer
      |> TrackTree.list_between(track, from, to)
      |> Enum.filter(&(&1.from < to and &1.to > from))

  defp fit_family(changes, parent, tier, {layer, explicit}) do
    # A child may overlap two parents after its old parent was split or shortened.
    family =
      changes
      |> current_between(layer, tier.name, parent)
      |> Enum.filter(&(find_parent(changes, layer, tier, &1).id == parent.id))
      |> Enum.sort_by(&{&1.from, &1.id})

    fitted = family |> join_values(tier, explicit) |> fit_times(tier.relation, parent)
    kept = Map.new(fitted, &{&1.id, &1})

    for child <- family, later = kept[child.id], later != child, reduce: changes do
      changes -> put_change(changes, child, later)
    end
    |> drop_missing(family, kept)
  end

  defp drop_missing(changes, family, kept) do
    for child <- family, not is_map_key(kept, child.id), reduce: changes do
      changes -> put_change(changes, child, nil)
    end
  end

  defp put_change(changes, child, later) do
    {before, _} = Map.get(changes, child.id, {child, child})
    Map.put(changes, child.id, {before, later})
  end

  # When two parents were merged, their associated annotations are joined, too.
  defp join_values([first, second | rest], %{relation: :symbolic_association} = tier, explicit) do
    if Enum.any?([first, second | rest], &(&1.id in explicit)),
      do: throw({:error, taken_error(tier, first)})

    values =
      Map.update(first.values, tier.attribute, nil, fn value ->
        join_texts(value, second.values[tier.attribute])
      end)

    join_values([%{first | values: values} | rest], tier, explicit)
  end

  defp join_values(family, _tier, _explicit), do: family

  defp join_texts(a, b) when is_binary(a) and is_binary(b) and a != b,
    do: String.trim("#{a} #{b}")

  defp join_texts(a, _b), do: a

  @doc """
  Returns the children of a parent, sorted by start, with the times that their relation demands. Children that would
  have no duration are left out.
  """
  @spec fit_times([Annotation.t()], Tier.relation(), Annotation.t()) :: [Annotation.t()]
  def fit_times(children, :included_in, parent) do
    for a <- children,
        from = max(a.from, parent.from),
        to = min(a.to, parent.to),
        from < to,
        do: %{a | from: from, to: to}
  end

  def fit_times(children, :time_subdivision, parent) do
    ends = children |> Enum.drop(1) |> Enum.map(&max(&1.from, parent.from))
    starts = Enum.take([parent.from | ends], length(children))

    for {a, {from, to}} <- Enum.zip(children, Enum.zip(starts, ends ++ [parent.to])),
        from < to,
        do: %{a | from: from, to: to}
  end

  def fit_times(children, :symbolic_subdivision, parent) do
    count = length(children)
    length = parent.to - parent.from

    for {a, i} <- Enum.with_index(children) do
      from = parent.from + div(length * i, count)
      %{a | from: from, to: parent.from + div(length * (i + 1), count)}
    end
  end

  def fit_times(children, :symbolic_association, parent),
    do: for(a <- children, do: %{a | from: parent.from, to: parent.to})

  @doc """
  Checks that the annotations of a transaction, and their children, fit their tiers in the layer after it. Errors:
  `:no_parent`, `:bad_tier`.
  """
  @spec check_transaction(layer(), transaction()) :: :ok | {:error, Error.t()}
  def check_transaction(%{schema: %{tiers: []}}, _transaction), do: :ok

  def check_transaction(%{} = layer, transaction) do
    changed = for {_, a, b} <- transaction, %Annotation{} = annotation <- [a, b], do: annotation
    children = Enum.flat_map(changed, &list_children(layer, &1))
    own = for {_, _, %Annotation{} = later} <- transaction, do: later

    (own ++ children ++ list_siblings(layer, changed))
    |> Enum.uniq_by(& &1.id)
    |> check_annotations(layer)
  end

  @doc "Checks all annotations of a layer."
  @spec check_layer(layer()) :: :ok | {:error, Error.t()}
  def check_layer(%{schema: %{tiers: []}}), do: :ok

  def check_layer(%{} = layer), do: layer.by_id |> Map.values() |> check_annotations(layer)

  # A parent with thousands of children is common (a whole recording), so each family is checked once, and not once for
  # each child. The keys of `checked` are pairs of a tier and a parent.
  defp check_annotations(annotations, layer) do
    result =
      Enum.reduce_while(annotations, %{}, fn annotation, checked ->
        case check_annotation(layer, annotation, checked) do
          {:error, _} = error -> {:halt, error}
          checked -> {:cont, checked}
        end
      end)

    if match?({:error, _}, result), do: result, else: :ok
  end

  @doc "Returns the children of an annotation on all tiers below its tier."
  @spec list_children(layer(), Annotation.t()) :: [Annotation.t()]
  def list_children(%{} = layer, annotation) do
    for tier <- Tier.child_tiers(layer.schema.tiers, annotation.track),
        child <- list_between(layer, tier.name, annotation),
        do: child
  end

  # Returns the annotations of the families that these annotations belong to.
  defp list_siblings(layer, annotations) do
    for(
      a <- annotations,
      %{parent: parent} = tier <- [Tier.find_tier(layer.schema.tiers, a.track)],
      parent != nil,
      p <- list_between(layer, parent, a),
      do: {tier.name, p}
    )
    |> Enum.uniq_by(fn {name, p} -> {name, p.id} end)
    |> Enum.flat_map(fn {name, p} -> list_between(layer, name, p) end)
  end

  @doc "Returns the annotation that an annotation depends on, or `nil`."
  @spec parent_annotation(layer(), Annotation.t()) :: Annotation.t() | nil
  def parent_annotation(%{} = layer, annotation) do
    case Tier.find_tier(layer.schema.tiers, annotation.track) do
      %{parent: parent} when parent != nil ->
        layer
        |> list_between(parent, annotation)
        |> Enum.find(&(&1.from <= annotation.from and annotation.to <= &1.to))

      _ ->
        nil
    end
  end

  defp check_annotation(layer, annotation, checked) do
    tiers = layer.schema.tiers
    tier = Tier.find_tier(tiers, annotation.track)

    cond do
      tier == nil ->
        checked

      Map.keys(annotation.values) -- [tier.attribute] != [] ->
        {:error, attribute_error(tier)}

      annotation.from == annotation.to and
          (tier.parent != nil or Tier.child_tiers(tiers, tier.name) != []) ->
        {:error,
         bad_tier_error(tier, "an annotation with a parent or children cannot be a point")}

      tier.parent == nil ->
        checked

      true ->
        check_family(layer, {tier, annotation}, checked)
    end
  end

  defp check_family(layer, {tier, annotation}, checked) do
    parent = parent_annotation(layer, annotation)

    cond do
      parent == nil -> {:error, no_parent_error(tier, annotation)}
      is_map_key(checked, {tier.name, parent.id}) -> checked
      family_valid?(layer, tier, parent) -> Map.put(checked, {tier.name, parent.id}, true)
      true -> {:error, bad_tier_error(tier, describe_relation(tier.relation))}
    end
  end

  defp family_valid?(layer, tier, parent) do
    family = layer |> list_between(tier.name, parent) |> Enum.sort_by(&{&1.from, &1.id})
    fit_times(family, tier.relation, parent) == family
  end

  defp describe_relation(:included_in), do: "its annotations must be inside their parents"

  defp describe_relation(:time_subdivision),
    do: "its annotations must fill their parents without gaps"

  defp describe_relation(:symbolic_subdivision),
    do: "its annotations must divide their parents into equal parts"

  defp describe_relation(:symbolic_association),
    do: "its annotations must have the times of their parents"

  defp attribute_error(tier) do
    Error.new(:bad_value, "track #{inspect(tier.name)} has only the attribute #{tier.attribute}",
      fix: "set this attribute, or annotate another track"
    )
  end

  defp bad_tier_error(tier, why) do
    Error.new(:bad_tier, "the annotation does not fit the tier #{inspect(tier.name)}",
      why: why,
      fix: "correct its times"
    )
  end

  defp no_parent_error(tier, annotation) do
    Error.new(:no_parent, "track #{inspect(tier.parent)} has no annotation at this time",
      why:
        "annotations of #{inspect(tier.name)} depend on it, and this one begins at " <>
          Situ.Time.to_iso8601(annotation.from),
      fix: "annotate #{inspect(tier.parent)} first"
    )
  end

  defp no_tier_error(tier, track) do
    Error.new(:no_parent, "the annotation cannot move to track #{inspect(track)}",
      why: "annotations of #{inspect(tier.name)} depend on it, and that track has no such tier",
      fix: "delete them first, or add the tier to the schema"
    )
  end

  defp taken_error(tier, annotation) do
    Error.new(:overlap, "track #{inspect(tier.name)} already has an annotation at this time",
      why:
        "an annotation of #{inspect(tier.parent)} has at most one, and it begins at " <>
          Situ.Time.to_iso8601(annotation.from),
      fix: "change its value"
    )
  end
end
