defmodule Situ.Lifecycle.Closing do
  @moduledoc false
  # In which order the outputs of a stopping pipeline close. Pure.
  #
  # The first rule that applies: (a) everything without an active input; (b) nothing while closing marks are still on
  # their way; (c) what is fed by itself alone; (d) what lies on pure cycles, where following inputs upstream leads only
  # back; (e) the one with most listened-to outputs. (a), (c) and (d) close all
  # that match, in order of construction: (c) and (d) those that still match when it is their turn.

  @type id :: pos_integer()
  @type edge :: %{from: id(), output: atom(), to: id()}

  @doc """
  `order`: ids not yet closed, in order of construction; `active`: edges whose consumer has not taken the closing mark.
  """
  @spec next([id()], [edge()]) :: {:close, [id()]} | :wait | {:break, [id()]} | :done
  def next([], []), do: :done
  def next([], _active), do: :wait

  def next(order, active) do
    fed = MapSet.new(active, & &1.to)
    open = MapSet.new(order)

    case Enum.reject(order, &MapSet.member?(fed, &1)) do
      [] ->
        if Enum.any?(active, &(not MapSet.member?(open, &1.from))),
          do: :wait,
          else: {:break, break(order, active)}

      free ->
        {:close, free}
    end
  end

  @doc "Which of `order` to close when every one of them waits for another: at least one."
  @spec break([id(), ...], [edge()]) :: [id(), ...]
  def break(order, active) do
    with [] <- one_by_one(order, active, &alone?/2),
         [] <- one_by_one(order, active, &pure?/2) do
      [Enum.max_by(order, &listened(&1, active), fn -> hd(order) end)]
    end
  end

  # Those for which the rule holds when it comes to them: closing one opens the cycle for the others on it.
  defp one_by_one(order, active, rule) do
    {chosen, _active} =
      Enum.flat_map_reduce(order, active, fn id, active ->
        if rule.(id, Enum.group_by(active, & &1.to, & &1.from)),
          do: {[id], Enum.reject(active, &(&1.from == id))},
          else: {[], active}
      end)

    chosen
  end

  defp alone?(id, upstream) do
    case Map.get(upstream, id, []) do
      [] -> false
      froms -> Enum.all?(froms, &(&1 == id))
    end
  end

  # Every way upstream from `id` ends at `id` again, before it meets a vertex twice.
  defp pure?(id, upstream),
    do: leads_back?(Map.get(upstream, id, []), id, upstream, MapSet.new([id]))

  defp leads_back?(froms, id, upstream, seen) do
    froms != [] and
      Enum.all?(froms, fn from ->
        from == id or
          (not MapSet.member?(seen, from) and
             leads_back?(Map.get(upstream, from, []), id, upstream, MapSet.put(seen, from)))
      end)
  end

  defp listened(id, active) do
    active |> Enum.filter(&(&1.from == id)) |> Enum.uniq_by(& &1.output) |> length()
  end
end
