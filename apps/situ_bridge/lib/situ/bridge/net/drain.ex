defmodule Situ.Bridge.Net.Drain do
  @moduledoc false
  # Closes a server after a bounded wait for its peers to receive all messages. The server passes `{:drain, ...}`, as a
  # call and as a message, to `reply_when_drained/3`.

  require Logger

  @poll_ms 5

  @doc """
  Waits until everything has been handed to the network, at most `timeout` ms, and stops the server. Returns the number
  of undelivered messages.
  """
  @spec close(pid(), non_neg_integer()) :: non_neg_integer()
  def close(server, timeout) do
    count = GenServer.call(server, {:drain, now_ms() + timeout}, timeout + 5_000)
    GenServer.stop(server)
    count
  catch
    :exit, _ -> 0
  end

  @doc """
  Replies when no messages are left, or when the time is over. A server that may lose messages (`lossy?`) logs their
  number and replies with 0.
  """
  @spec reply_when_drained(
          GenServer.from(),
          deadline :: integer(),
          count :: non_neg_integer(),
          lossy? :: boolean()
        ) ::
          :ok
  def reply_when_drained(from, deadline, count, lossy? \\ false) do
    cond do
      count > 0 and now_ms() < deadline ->
        Process.send_after(self(), {:drain, from, deadline}, @poll_ms)

      count > 0 and lossy? ->
        Logger.warning("#{count} messages were dropped on closing, because peers were too slow")
        GenServer.reply(from, 0)

      true ->
        GenServer.reply(from, count)
    end

    :ok
  end

  defp now_ms, do: System.monotonic_time(:millisecond)
end
