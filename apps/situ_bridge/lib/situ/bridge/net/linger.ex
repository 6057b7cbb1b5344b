defmodule Situ.Bridge.Net.Linger do
  @moduledoc false
  # The end of a server: what its peers have not taken yet is waited for, but not for ever. The server hands
  # `{:drain, ...}`, as a call and as a message, to `drain/3`.

  require Logger

  @look_again 5

  @doc """
  Waits until everything has been handed to the network, at most `timeout` ms, and stops the server. Answers how many
  messages were left.
  """
  @spec close(pid(), non_neg_integer()) :: non_neg_integer()
  def close(server, timeout) do
    left = GenServer.call(server, {:drain, now() + timeout}, timeout + 5_000)
    GenServer.stop(server)
    left
  catch
    :exit, _ -> 0
  end

  @doc """
  Answers when none of the messages that are `left` are any more, or when it is time. A server that may lose messages
  (`lossy?`) says how many, and counts none.
  """
  @spec drain(
          GenServer.from(),
          until :: integer(),
          left :: non_neg_integer(),
          lossy? :: boolean()
        ) ::
          :ok
  def drain(from, until, left, lossy? \\ false) do
    cond do
      left > 0 and now() < until ->
        Process.send_after(self(), {:drain, from, until}, @look_again)

      left > 0 and lossy? ->
        Logger.warning("#{left} messages were dropped at the end, for peers that are too slow")
        GenServer.reply(from, 0)

      true ->
        GenServer.reply(from, left)
    end

    :ok
  end

  defp now, do: System.monotonic_time(:millisecond)
end
