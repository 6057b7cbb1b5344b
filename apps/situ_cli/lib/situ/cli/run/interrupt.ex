defmodule Situ.CLI.Run.Interrupt do
  @moduledoc false
  # Turns SIGTERM into a message, so that a pipeline can deliver its last messages and close its recordings. The script
  # bin/situ sends SIGTERM for Ctrl-C as well, because the VM cannot handle SIGINT.

  @doc """
  Calls `fun`, and sends `message` to the calling process at the first SIGTERM during the call. Later signals have no
  effect.
  """
  @spec with_message(term(), (() -> result)) :: result when result: term()
  def with_message(message, fun) do
    receiver = self()
    sent = :atomics.new(1, [])

    {:ok, trap} =
      System.trap_signal(:sigterm, fn ->
        if :atomics.exchange(sent, 1, 1) == 0, do: send(receiver, message)
        :ok
      end)

    try do
      fun.()
    after
      System.untrap_signal(:sigterm, trap)
    end
  end
end
