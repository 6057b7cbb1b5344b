defmodule Situ.Stage.Pause do
  @moduledoc false
  # Pauses a source for a checkpoint. It emits nothing and takes nothing from its mailbox. Messages that it has
  # posted are still sent on demand, and changes to its connections are still performed.
  alias Situ.Ports.{Output, Outputs}
  alias Situ.Stage.State

  # The process that froze it may have died, so the freeze has a limit.
  @longest_ms 60_000

  # These start and end nothing. The component's replies to them wait until the stage resumes.
  defguardp change(request)
            when request == :describe or
                   (is_tuple(request) and
                      elem(request, 0) in [:tap, :untap, :replace, :guarantee, :lend])

  @doc """
  Returns when `{:thaw, ref}` arrives. `change` performs a request and returns the state and the component's actions.
  The collected actions are returned with the final state.
  """
  @spec wait_for_thaw(State.t(), reference(), (term(), State.t() -> {State.t(), [term()]})) ::
          {State.t(), [term()]}
  def wait_for_thaw(%{pace: %{scheduled: scheduled?}} = state, ref, change) do
    # A time slice only sends pending messages while another one is due.
    {state, actions} = stand(resumed(state, true), ref, change, [])
    {resumed(state, scheduled?), actions}
  end

  defp resumed(state, scheduled?), do: %{state | pace: %{state.pace | scheduled: scheduled?}}

  defp stand(%{owner: {server, _id}} = state, ref, change, actions) do
    receive do
      {:situ, {:thaw, ^ref}} ->
        {state, actions}

      {:"$gen_producer", {pid, _tag} = from, {:ask, n}}
      when is_pid(pid) and ((is_integer(n) and n > 0) or n == :infinity) ->
        stand(asked(state, from, n), ref, change, actions)

      {:situ, {:refresh, from}} ->
        refresh =
          &if(Output.has_subscriber?(&1, from), do: Output.refresh_subscriber(&1, from), else: &1)

        state = %{state | outputs: Outputs.map_outputs(state.outputs, refresh)}
        stand(state, ref, change, actions)

      {:situ, request} when change(request) ->
        {state, more} = change.(request, state)
        stand(state, ref, change, actions ++ more)

      {:EXIT, ^server, _reason} = message ->
        send(self(), message)
        {state, actions}
    after
      @longest_ms -> {state, actions}
    end
  end

  defp asked(state, from, n) do
    case Outputs.add_demand(state.outputs, from, n) do
      {:ok, outputs} -> State.wake_source(%{state | outputs: outputs})
      :error -> state
    end
  end
end
