defmodule Situ.Pipeline.Upstream do
  @moduledoc false
  # What the sources upstream of a stage say about it. Pure.
  alias Situ.Graph.Vertex

  @type id :: pos_integer()

  @doc """
  The stages that get whole streams: every source upstream is among the `finite` ones, which have told their last time,
  and none of them lies on or behind a cycle.
  """
  @spec whole(
          %{id() => %{vertices: [Vertex.t(), ...]}},
          [%{from: id(), to: id()}],
          MapSet.t(id())
        ) ::
          MapSet.t(id())
  def whole(stages, links, finite) do
    upstream = Enum.group_by(links, & &1.to, & &1.from)

    candidates =
      for {id, %{vertices: [head | _]}} <- stages,
          not Vertex.source?(head) or MapSet.member?(finite, id),
          do: {id, Map.get(upstream, id, [])}

    grow(candidates, MapSet.new())
  end

  # Adds those whose neighbours upstream are all in, until none is left to add; a cycle never gets in.
  defp grow(candidates, whole) do
    case Enum.split_with(candidates, fn {_id, froms} -> Enum.all?(froms, &(&1 in whole)) end) do
      {[], _rest} -> whole
      {more, rest} -> grow(rest, Enum.into(more, whole, &elem(&1, 0)))
    end
  end
end
