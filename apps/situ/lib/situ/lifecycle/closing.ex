defmodule Situ.Lifecycle.Closing do
  @moduledoc false
  # Decides in which order the outputs of a stopping pipeline close. Pure.
  #
  # The first rule that applies decides:
  #   (a) close every stage without an active input;
  #   (b) wait while closing marks are still in flight;
  #   (c) close the stages that are fed only by themselves;
  #   (d) close the stages on pure cycles, where following the inputs upstream only leads back;
  #   (e) close the stage with the most outputs that have subscribers.
  # Rules (a), (c) and (d) close all matching stages in order of construction. Under (c) and (d) a stage must still
  # match after the earlier ones have closed.
  # See docs/adr/0018-outputs-close-when-inputs-close.md.

  @type id :: pos_integer()
  @type edge :: %{from: id(), output: atom(), to: id()}

  @doc """
  Returns the next step. `order` holds the ids that are not closed yet, in order of construction. `active` holds the
  edges whose consumer has not taken the closing mark.
  """
  @spec next_to_close([id()], [edge()]) :: {:close, [id()]} | :wait | {:break, [id()]} | :done
  def next_to_close([], []), do: :done
  def next_to_close([], _active), do: :wait

  def next_to_close(order, active) do
    fed = MapSet.new(active, & &1.to)
    open = MapSet.new(order)

    case Enum.reject(order, &MapSet.member?(fed, &1)) do
      [] ->
        if Enum.any?(active, &(not MapSet.member?(open, &1.from))),
          do: :wait,
          else: {:break, break_cycle(order, active)}

      free ->
        {:close, free}
    end
  end

  @doc "Returns the ids in `order` to close when all of them wait for each other; at least one."
  @spec break_cycle([id(), ...], [edge()]) :: [id(), ...]
  def break_cycle(order, active) do
    with [] <- select_in_order(order, active, &fed_by_itself?/2),
         [] <- select_in_order(order, active, &on_pure_cycle?/2) do
      [Enum.max_by(order, &count_listened_outputs(&1, active), fn -> hd(order) end)]
    end
  end

  # Tests the rule for each id after the earlier ones have closed, since closing one stage opens its cycle for the rest.
  defp select_in_order(order, active, rule) do
    {chosen, _active} =
      Enum.flat_map_reduce(order, active, fn id, active ->
        if rule.(id, Enum.group_by(active, & &1.to, & &1.from)),
          do: {[id], Enum.reject(active, &(&1.from == id))},
          else: {[], active}
      end)

    chosen
  end

  defp fed_by_itself?(id, upstream) do
    case Map.get(upstream, id, []) do
      [] -> false
      froms -> Enum.all?(froms, &(&1 == id))
    end
  end

  # Every path upstream from `id` leads back to `id` before it meets another vertex twice.
  defp on_pure_cycle?(id, upstream),
    do: leads_back?(Map.get(upstream, id, []), id, upstream, MapSet.new([id]))

  defp leads_back?(froms, id, upstream, seen) do
    froms != [] and
      Enum.all?(froms, fn from ->
        from == id or
          (not MapSet.member?(seen, from) and
             leads_back?(Map.get(upstream, from, []), id, upstream, MapSet.put(seen, from)))
      end)
  end

  defp count_listened_outputs(id, active) do
    active |> Enum.filter(&(&1.from == id)) |> Enum.uniq_by(& &1.output) |> length()
  end
end
