defmodule Situ.Stage.Pause do
  @moduledoc false
  # Pauses a source for a checkpoint. It emits nothing and takes nothing from its mailbox. Messages that it has
  # posted are still sent on demand, and changes to its connections are still performed.
  alias Situ.Ports.Outputs
  alias Situ.Stage.{State, Step}

  # The process that froze it may have died, so the freeze has a limit.
  @longest_ms 60_000

  @doc "Returns the time (ms) after which a stage resumes by itself."
  @spec longest_ms() :: pos_integer()
  def longest_ms, do: @longest_ms

  # These start and end nothing. The component's replies to them wait until the stage resumes.
  defguard change(request)
           when request == :describe or
                  (is_tuple(request) and
                     elem(request, 0) in [:tap, :untap, :peer, :replace, :guarantee, :lend])

  @doc """
  Returns when `{:thaw, ref}` arrives. `change` performs a request and returns the state and the component's actions.
  The collected actions are returned with the final state.
  """
  @spec wait_for_thaw(State.t(), term(), (term(), State.t() -> {State.t(), [term()]})) ::
          {State.t(), [term()]}
  def wait_for_thaw(%{scheduled: scheduled?} = state, ref, change) do
    # A time slice only sends pending messages while another one is due.
    {state, actions} = wait(%{state | scheduled: true}, ref, change, [])
    {%{state | scheduled: scheduled?}, actions}
  end

  defp wait(%{host: %{owner: {server, _id}}} = state, ref, change, actions) do
    receive do
      {:situ, {:thaw, ^ref}} ->
        {state, actions}

      {:"$gen_producer", {pid, _tag} = from, {:ask, n}}
      when is_pid(pid) and ((is_integer(n) and n > 0) or n == :infinity) ->
        state |> update_outputs(&Outputs.add_demand(&1, from, n)) |> wait(ref, change, actions)

      {:situ, {:refresh, from}} ->
        state
        |> update_outputs(&Outputs.refresh_subscriber(&1, from))
        |> wait(ref, change, actions)

      {:situ, request} when change(request) ->
        {state, more} = change.(request, state)
        wait(state, ref, change, actions ++ more)

      {:EXIT, ^server, _reason} = message ->
        send(self(), message)
        {state, actions}
    after
      @longest_ms -> {state, actions}
    end
  end

  defp update_outputs(state, fun) do
    case State.update_outputs(state, fun) do
      {:ok, state} -> State.map_steps(state, &Step.wake_source/1)
      :error -> state
    end
  end
end
