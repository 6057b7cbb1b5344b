defmodule Situ.Bridge.Net.Linger do
  @moduledoc false
  # The end of a server: what its peers have not taken yet is waited for, but not for ever. The server hands
  # `{:drain, ...}`, as a call and as a message, to `drain/3`.

  @look_again 5

  @doc "Waits until everything has been handed to the network, at most `timeout` ms, and stops the server."
  @spec close(pid(), non_neg_integer()) :: :ok
  def close(server, timeout) do
    GenServer.call(server, {:drain, now() + timeout}, timeout + 5_000)
    GenServer.stop(server)
  catch
    :exit, _ -> :ok
  end

  @spec drain(GenServer.from(), until :: integer(), waiting? :: boolean()) :: :ok
  def drain(from, until, waiting?) do
    if waiting? and now() < until,
      do: Process.send_after(self(), {:drain, from, until}, @look_again),
      else: GenServer.reply(from, :ok)

    :ok
  end

  defp now, do: System.monotonic_time(:millisecond)
end
