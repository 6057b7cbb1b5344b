defmodule Situ.Lifecycle.Removal do
  @moduledoc false
  # Drops removed stages whose processes have ended. The life cycle drops such a stage only after its consumers have
  # taken its closing marks; until then its connections count. The server keeps everything that belongs to a stage
  # until the life cycle emits `{:drop, id}`, so that no event finds a partly removed stage. Pure.
  #
  # The server once dropped the entry of a detached tap before the life cycle had closed it. A
  # request to the missing stage then crashed the server, and the pipeline lost its messages in
  # flight.
  alias Situ.Lifecycle.{Links, State}
  import Situ.Lifecycle.State

  @doc "Records that the process of a removed stage has ended."
  @spec mark_leaving(State.t(), State.id()) :: State.t()
  def mark_leaving(%{stages: stages} = state, id) when is_map_key(stages, id),
    do: %{state | leaving: MapSet.put(state.leaving, id)}

  def mark_leaving(state, _id), do: state

  @doc "Drops the removed stages that have no consumers left."
  @spec drop_unconsumed(State.t()) :: State.t()
  def drop_unconsumed(%{leaving: leaving} = state) do
    if MapSet.size(leaving) == 0,
      do: state,
      else:
        leaving
        |> Enum.filter(&no_consumers_left?(state, &1))
        |> Enum.reduce(state, &drop_stage/2)
  end

  defp no_consumers_left?(state, id),
    do: Enum.all?(Links.list_outgoing(state.links, id), fn {_, link} -> link.to == id end)

  defp drop_stage(id, state) do
    state = clear_pending(state, id)

    add_action(
      %{
        state
        | stages: Map.delete(state.stages, id),
          links: Links.forget_stage(state.links, id),
          leaving: MapSet.delete(state.leaving, id),
          awaited: MapSet.delete(state.awaited, id),
          parts: Map.new(state.parts, fn {ref, part} -> {ref, remove_from_part(part, id)} end)
      },
      {:drop, id}
    )
  end

  defp remove_from_part(part, id),
    do: %{part | ids: MapSet.delete(part.ids, id), pending: MapSet.delete(part.pending, id)}
end
