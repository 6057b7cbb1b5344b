defmodule Situ.Lifecycle.Links do
  @moduledoc false
  # The connections between the stages of a pipeline, by both of their ends. Pure.
  #
  #   active    those whose consumer has not taken the closing mark yet
  #   closing   active ones whose producer has closed, with the time: the mark is under way
  #   topology  all there ever were, for what follows the way of the streams

  @type id :: pos_integer()
  @type link :: %{
          required(:from) => id(),
          required(:to) => id(),
          required(:output) => atom(),
          optional(atom()) => term()
        }

  defstruct active: %{}, into: %{}, out_of: %{}, closing: %{}, topology: %{}

  @type t :: %__MODULE__{
          active: %{term() => link()},
          into: %{id() => MapSet.t()},
          out_of: %{id() => MapSet.t()},
          closing: %{term() => Situ.Time.t()},
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
        into: put(links.into, link.to, tag),
        out_of: put(links.out_of, link.from, tag),
        topology: Map.put(links.topology, tag, link)
    }
  end

  @doc "The consumer has taken the closing mark, or is gone."
  @spec drop(t(), term()) :: t()
  def drop(links, tag) do
    case links.active do
      %{^tag => link} ->
        %{
          links
          | active: Map.delete(links.active, tag),
            into: delete(links.into, link.to, tag),
            out_of: delete(links.out_of, link.from, tag),
            closing: Map.delete(links.closing, tag)
        }

      _ ->
        links
    end
  end

  @doc "As though it had never been there."
  @spec forget(t(), term()) :: t()
  def forget(links, tag) do
    links = drop(links, tag)
    %{links | topology: Map.delete(links.topology, tag)}
  end

  @doc "The outputs of `id` have closed at `time`: its closing marks are under way."
  @spec close(t(), id(), Situ.Time.t()) :: t()
  def close(links, id, time) do
    tags = Map.get(links.out_of, id, [])
    %{links | closing: Enum.into(tags, links.closing, &{&1, time})}
  end

  @doc "The stage itself is forgotten."
  @spec forget_all(t(), id()) :: t()
  def forget_all(links, id) do
    tags = for {tag, link} <- links.topology, link.from == id or link.to == id, do: tag
    Enum.reduce(tags, links, &forget(&2, &1))
  end

  @spec into(t(), id()) :: [{term(), link()}]
  def into(links, id), do: look(links, Map.get(links.into, id, []))

  @spec out_of(t(), id()) :: [{term(), link()}]
  def out_of(links, id), do: look(links, Map.get(links.out_of, id, []))

  @doc "Whether nothing comes into `id` any more."
  @spec free?(t(), id()) :: boolean()
  def free?(links, id), do: not is_map_key(links.into, id)

  @doc "All stages that get, over however many others, something of `id`; itself only on a cycle."
  @spec downstream(t(), id()) :: MapSet.t(id())
  def downstream(links, id) do
    next = Enum.group_by(Map.values(links.topology), & &1.from, & &1.to)
    follow(Map.get(next, id, []), next, MapSet.new())
  end

  defp follow([], _next, seen), do: seen

  defp follow([id | rest], next, seen) do
    if MapSet.member?(seen, id),
      do: follow(rest, next, seen),
      else: follow(Map.get(next, id, []) ++ rest, next, MapSet.put(seen, id))
  end

  @doc """
  The stages that get whole streams: every source upstream is among the `finite` ones, which have told their last time,
  and none of them lies on or behind a cycle.
  """
  @spec whole(
          %{id() => %{source?: boolean()}},
          [%{from: id(), to: id()}],
          MapSet.t(id())
        ) ::
          MapSet.t(id())
  def whole(stages, links, finite) do
    downstream = Enum.group_by(links, & &1.from, & &1.to)
    # How many links into each stage come from stages that are not known to be whole.
    unknown = Enum.frequencies_by(links, & &1.to)

    endless =
      for {id, %{source?: true}} <- stages,
          not MapSet.member?(finite, id),
          into: MapSet.new(),
          do: id

    first = for {id, _stage} <- stages, not is_map_key(unknown, id), do: id
    reach(first, downstream, unknown, {endless, MapSet.new()})
  end

  # A cycle is never entered: its stages wait for one another.
  defp reach([], _downstream, _unknown, {_endless, whole}), do: whole

  defp reach([id | rest], downstream, unknown, {endless, whole} = sets) do
    if MapSet.member?(endless, id) do
      reach(rest, downstream, unknown, sets)
    else
      {rest, unknown} = downstream |> Map.get(id, []) |> Enum.reduce({rest, unknown}, &arrived/2)

      reach(rest, downstream, unknown, {endless, MapSet.put(whole, id)})
    end
  end

  defp arrived(id, {rest, unknown}) do
    case Map.fetch!(unknown, id) do
      1 -> {[id | rest], Map.delete(unknown, id)}
      n -> {rest, %{unknown | id => n - 1}}
    end
  end

  defp look(links, tags), do: for(tag <- tags, do: {tag, Map.fetch!(links.active, tag)})

  defp put(sets, id, tag), do: Map.update(sets, id, MapSet.new([tag]), &MapSet.put(&1, tag))

  # A stage without any is no key: `free?/2` is one look.
  defp delete(sets, id, tag) do
    rest = MapSet.delete(Map.fetch!(sets, id), tag)
    if MapSet.size(rest) == 0, do: Map.delete(sets, id), else: %{sets | id => rest}
  end
end
