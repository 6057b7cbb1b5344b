defmodule Situ.Lifecycle.Removal do
  @moduledoc false
  # Drops removed stages whose processes have ended. The life cycle drops such a stage only after its consumers have
  # taken its closing marks; until then its connections count. The server keeps everything that belongs to a stage
  # until the life cycle emits `{:drop, id}`, so that no event finds only a part of it. Pure.
  alias Situ.Lifecycle.{Links, State}
  import Situ.Lifecycle.State

  @doc "Records that the process of a removed stage has ended."
  @spec leave(State.t(), State.id()) :: State.t()
  def leave(%{stages: stages} = state, id) when is_map_key(stages, id),
    do: %{state | leaving: MapSet.put(state.leaving, id)}

  def leave(state, _id), do: state

  @doc "Drops the removed stages that have no consumers left."
  @spec drop_left(State.t()) :: State.t()
  def drop_left(%{leaving: leaving} = state) do
    if MapSet.size(leaving) == 0,
      do: state,
      else: leaving |> Enum.filter(&unconsumed?(state, &1)) |> Enum.reduce(state, &drop/2)
  end

  defp unconsumed?(state, id),
    do: Enum.all?(Links.out_of(state.links, id), fn {_, link} -> link.to == id end)

  defp drop(id, state) do
    state = answered(state, id)

    act(
      %{
        state
        | stages: Map.delete(state.stages, id),
          links: Links.forget_all(state.links, id),
          leaving: MapSet.delete(state.leaving, id),
          awaited: MapSet.delete(state.awaited, id),
          parts: Map.new(state.parts, fn {ref, part} -> {ref, without(part, id)} end)
      },
      {:drop, id}
    )
  end

  defp without(part, id),
    do: %{part | ids: MapSet.delete(part.ids, id), pending: MapSet.delete(part.pending, id)}
end
