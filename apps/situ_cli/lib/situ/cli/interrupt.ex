defmodule Situ.CLI.Interrupt do
  @moduledoc false
  # Turns SIGTERM into a message, so that a pipeline can deliver its last messages and close its recordings. The script
  # bin/situ sends SIGTERM for Ctrl-C as well, because the VM cannot handle SIGINT.
  #
  # This module replaces Erlang's handler of signals. A handler that is only added (`System.trap_signal/2`) could not
  # prevent Erlang's own from stopping the VM.
  @behaviour :gen_event

  @doc """
  Calls `fun`, and sends `message` to the calling process at the first SIGTERM during the call. Later signals have no
  effect.
  """
  @spec with_message(term(), (() -> result)) :: result when result: term()
  def with_message(message, fun) do
    swap_handlers({:erl_signal_handler, []}, {__MODULE__, {self(), message}})

    try do
      fun.()
    after
      swap_handlers({__MODULE__, []}, {:erl_signal_handler, []})
    end
  end

  defp swap_handlers(old, new), do: :ok = :gen_event.swap_handler(:erl_signal_server, old, new)

  @impl true
  def init({{receiver, message}, _old}), do: {:ok, {receiver, message}}

  @impl true
  def handle_event(:sigterm, {receiver, message}) do
    send(receiver, message)
    {:ok, :sent}
  end

  def handle_event(:sigterm, :sent), do: {:ok, :sent}

  # All other signals have their usual effect.
  def handle_event(signal, state) do
    _ = :erl_signal_handler.handle_event(signal, [])
    {:ok, state}
  end

  @impl true
  def handle_call(_request, state), do: {:ok, :ok, state}
end
