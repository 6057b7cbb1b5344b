defmodule Situ.Lifecycle.Links do
  @moduledoc false
  # The connections between the stages of a pipeline, indexed by both ends. Pure.
  #
  #   active    links whose consumers have not taken the closing mark yet
  #   closing   active links whose producers have closed, with the time; their closing marks are in flight
  #   ended     the closing times of links that are no longer active
  #   topology  all links that ever existed, to find the stages downstream of a stage

  @type id :: pos_integer()
  @type link :: %{
          required(:from) => id(),
          required(:to) => id(),
          required(:output) => atom(),
          optional(atom()) => term()
        }

  defstruct active: %{}, into: %{}, out_of: %{}, closing: %{}, ended: %{}, topology: %{}

  @type t :: %__MODULE__{
          active: %{term() => link()},
          into: %{id() => MapSet.t()},
          out_of: %{id() => MapSet.t()},
          closing: %{term() => Situ.Time.t()},
          ended: %{term() => Situ.Time.t() | nil},
          topology: %{term() => link()}
        }

  @spec new(%{term() => link()}) :: t()
  def new(links),
    do: Enum.reduce(links, %__MODULE__{}, fn {tag, link}, all -> add(all, tag, link) end)

  @spec add(t(), term(), link()) :: t()
  def add(links, tag, link) do
    %{
      links
      | active: Map.put(links.active, tag, link),
        into: put_tag(links.into, link.to, tag),
        out_of: put_tag(links.out_of, link.from, tag),
        topology: Map.put(links.topology, tag, link)
    }
  end

  @doc "Deactivates a link whose consumer has taken the closing mark or has ended."
  @spec deactivate_link(t(), term()) :: t()
  def deactivate_link(links, tag) do
    case links.active do
      %{^tag => link} ->
        %{
          links
          | active: Map.delete(links.active, tag),
            into: delete_tag(links.into, link.to, tag),
            out_of: delete_tag(links.out_of, link.from, tag),
            closing: Map.delete(links.closing, tag),
            ended: Map.put(links.ended, tag, links.closing[tag])
        }

      _ ->
        links
    end
  end

  @doc "Removes a link completely, as if it had never existed."
  @spec forget_link(t(), term()) :: t()
  def forget_link(links, tag) do
    links = deactivate_link(links, tag)
    %{links | topology: Map.delete(links.topology, tag), ended: Map.delete(links.ended, tag)}
  end

  @doc "Activates the closed inputs of a stage that starts again: it takes their closing marks again."
  @spec reopen_inputs(t(), id()) :: t()
  def reopen_inputs(links, id) do
    closed =
      for {tag, %{to: ^id, from: from} = link} <- links.topology,
          from != id and not is_map_key(links.active, tag),
          time = links.ended[tag],
          do: {tag, link, time}

    Enum.reduce(closed, links, fn {tag, link, time}, links ->
      links |> add(tag, link) |> close_link(tag, time)
    end)
  end

  @doc "Records that the outputs of a stage that had closed are open again."
  @spec reopen_outputs(t(), id()) :: t()
  def reopen_outputs(links, id) do
    outputs = links.out_of |> Map.get(id, []) |> Enum.to_list()
    %{links | closing: Map.drop(links.closing, outputs)}
  end

  @doc "Records that the outputs of `id` closed at `time`, so that its closing marks are in flight."
  @spec close_outputs(t(), id(), Situ.Time.t()) :: t()
  def close_outputs(links, id, time) do
    tags = Map.get(links.out_of, id, [])
    %{links | closing: Enum.into(tags, links.closing, &{&1, time})}
  end

  @doc "Records that an active link closes at `time`, unless it is closing already."
  @spec close_link(t(), term(), Situ.Time.t()) :: t()
  def close_link(links, tag, time),
    do: %{links | closing: Map.put_new(links.closing, tag, time)}

  @doc "Removes all links of a stage."
  @spec forget_stage(t(), id()) :: t()
  def forget_stage(links, id) do
    tags = for {tag, link} <- links.topology, link.from == id or link.to == id, do: tag
    Enum.reduce(tags, links, &forget_link(&2, &1))
  end

  @spec list_incoming(t(), id()) :: [{term(), link()}]
  def list_incoming(links, id), do: fetch_links(links, Map.get(links.into, id, []))

  @spec list_outgoing(t(), id()) :: [{term(), link()}]
  def list_outgoing(links, id), do: fetch_links(links, Map.get(links.out_of, id, []))

  @doc "Returns whether `id` has no active input left."
  @spec no_inputs?(t(), id()) :: boolean()
  def no_inputs?(links, id), do: not is_map_key(links.into, id)

  @doc "Returns all stages downstream of `id`, directly or indirectly; includes `id` only if it is on a cycle."
  @spec downstream_ids(t(), id()) :: MapSet.t(id())
  def downstream_ids(links, id) do
    next = Enum.group_by(Map.values(links.topology), & &1.from, & &1.to)
    collect_downstream(Map.get(next, id, []), next, MapSet.new())
  end

  defp collect_downstream([], _next, seen), do: seen

  defp collect_downstream([id | rest], next, seen) do
    if MapSet.member?(seen, id),
      do: collect_downstream(rest, next, seen),
      else: collect_downstream(Map.get(next, id, []) ++ rest, next, MapSet.put(seen, id))
  end

  @doc """
  Returns the stages whose input streams are complete: every source upstream is in `finite`, the sources that have
  reported their end, and the stage is neither on a cycle nor downstream of one.
  """
  @spec complete_stages(
          %{id() => %{source?: boolean()}},
          [%{from: id(), to: id()}],
          MapSet.t(id())
        ) ::
          MapSet.t(id())
  def complete_stages(stages, links, finite) do
    downstream = Enum.group_by(links, & &1.from, & &1.to)
    # Counts, for each stage, the links from stages whose streams are not known to be complete.
    unknown = Enum.frequencies_by(links, & &1.to)

    endless =
      for {id, %{source?: true}} <- stages,
          not MapSet.member?(finite, id),
          into: MapSet.new(),
          do: id

    first = for {id, _stage} <- stages, not is_map_key(unknown, id), do: id
    collect_complete(first, downstream, unknown, {endless, MapSet.new()})
  end

  # A cycle is never entered, because its stages wait for each other.
  defp collect_complete([], _downstream, _unknown, {_endless, complete}), do: complete

  defp collect_complete([id | rest], downstream, unknown, {endless, complete} = sets) do
    if MapSet.member?(endless, id) do
      collect_complete(rest, downstream, unknown, sets)
    else
      {rest, unknown} =
        downstream |> Map.get(id, []) |> Enum.reduce({rest, unknown}, &count_arrival/2)

      collect_complete(rest, downstream, unknown, {endless, MapSet.put(complete, id)})
    end
  end

  defp count_arrival(id, {rest, unknown}) do
    case Map.fetch!(unknown, id) do
      1 -> {[id | rest], Map.delete(unknown, id)}
      n -> {rest, %{unknown | id => n - 1}}
    end
  end

  defp fetch_links(links, tags), do: for(tag <- tags, do: {tag, Map.fetch!(links.active, tag)})

  defp put_tag(sets, id, tag), do: Map.update(sets, id, MapSet.new([tag]), &MapSet.put(&1, tag))

  # A stage without links has no key, so that `no_inputs?/2` is a single lookup.
  defp delete_tag(sets, id, tag) do
    rest = MapSet.delete(Map.fetch!(sets, id), tag)
    if MapSet.size(rest) == 0, do: Map.delete(sets, id), else: %{sets | id => rest}
  end
end
