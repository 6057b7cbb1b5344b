defmodule Situ.Pipeline.Lifecycle.Upstream do
  @moduledoc false
  # What the sources upstream of a stage say about it. Pure.
  @type id :: pos_integer()

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
    follow(first, downstream, unknown, {endless, MapSet.new()})
  end

  # A cycle is never entered: its stages wait for one another.
  defp follow([], _downstream, _unknown, {_endless, whole}), do: whole

  defp follow([id | rest], downstream, unknown, {endless, whole} = sets) do
    if MapSet.member?(endless, id) do
      follow(rest, downstream, unknown, sets)
    else
      {rest, unknown} = downstream |> Map.get(id, []) |> Enum.reduce({rest, unknown}, &arrived/2)

      follow(rest, downstream, unknown, {endless, MapSet.put(whole, id)})
    end
  end

  defp arrived(id, {rest, unknown}) do
    case Map.fetch!(unknown, id) do
      1 -> {[id | rest], Map.delete(unknown, id)}
      n -> {rest, %{unknown | id => n - 1}}
    end
  end
end
