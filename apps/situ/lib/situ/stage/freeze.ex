defmodule Situ.Stage.Freeze do
  @moduledoc false
  # A source that stands still, for a checkpoint: it makes nothing and takes nothing from its mailbox, but what it has
  # posted still goes out as it is asked for.
  alias Situ.Ports.{Output, Outputs}
  alias Situ.Stage.State

  # The process that froze it may have died, so the freeze has a limit.
  @longest_ms 60_000

  @doc "Returns when `{:thaw, ref}` comes."
  @spec until(State.t(), reference()) :: State.t()
  def until(%{owner: {server, _id}} = state, ref) do
    receive do
      {:situ, {:thaw, ^ref}} ->
        state

      {:"$gen_producer", {pid, _tag} = from, {:ask, n}}
      when is_pid(pid) and ((is_integer(n) and n > 0) or n == :infinity) ->
        until(asked(state, from, n), ref)

      {:situ, {:refresh, from}} ->
        refresh = &if(Output.subscriber?(&1, from), do: Output.refresh(&1, from), else: &1)
        until(%{state | outputs: Outputs.each(state.outputs, refresh)}, ref)

      {:EXIT, ^server, _reason} = message ->
        send(self(), message)
        state
    after
      @longest_ms -> state
    end
  end

  defp asked(state, from, n) do
    case Outputs.ask(state.outputs, from, n) do
      {:ok, outputs} -> State.wake(%{state | outputs: outputs})
      :error -> state
    end
  end
end
