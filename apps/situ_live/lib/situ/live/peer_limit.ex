defmodule Situ.Live.PeerLimit do
  @moduledoc false
  # Limits the connections that one peer holds on a port. The web server limits only their total, so one peer could
  # open all of them and lock everyone else out before it sends a byte. A separate process therefore counts them.

  # Half of the web server's limit.
  @max_per_peer 1_000

  @doc """
  Returns the processes of connections that exceed the limit of their address, and the processes that may stay.

  `known` is the set of processes that could stay at the last call: they have precedence over later connections.
  """
  @spec find_excess(:inet.port_number(), MapSet.t(pid()), pos_integer()) ::
          {[pid()], MapSet.t(pid())}
  def find_excess(port, known, max \\ @max_per_peer) do
    # The check costs a few microseconds per connection and is unnecessary when there are few.
    if :erlang.system_info(:port_count) > div(max, 2) do
      {allowed, excess} =
        port
        |> list_connections()
        |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
        |> Enum.map(fn {_address, pids} ->
          pids |> Enum.sort_by(&(&1 not in known)) |> Enum.split(max)
        end)
        |> Enum.unzip()

      {List.flatten(excess), allowed |> List.flatten() |> MapSet.new()}
    else
      {[], MapSet.new()}
    end
  end

  defp list_connections(port) do
    for socket <- :erlang.ports(),
        :erlang.port_info(socket, :name) == {:name, ~c"tcp_inet"},
        {:ok, {_, ^port}} <- [:inet.sockname(socket)],
        {:ok, {address, _}} <- [:inet.peername(socket)],
        {:connected, pid} <- [:erlang.port_info(socket, :connected)],
        do: {address, pid}
  end
end
