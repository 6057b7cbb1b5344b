defmodule Situ.Live.Peers do
  @moduledoc false
  # Who holds the connections of a port. The web server bounds how many there are, not who holds them: one peer that
  # opens all of them would keep everybody else out, before it has sent a byte. So they are counted from outside.

  # Half of what the web server takes.
  @most 1_000

  @doc """
  Returns the processes of connections to a port beyond the share of their address, and the processes that may stay.

  `earlier` is the set of processes that could stay at the last call: they have precedence over later connections.
  """
  @spec find_excess(:inet.port_number(), MapSet.t(pid()), pos_integer()) ::
          {[pid()], MapSet.t(pid())}
  def find_excess(port, earlier, most \\ @most) do
    # Looking costs a few microseconds a connection; with few there is nothing to see.
    if :erlang.system_info(:port_count) > div(most, 2) do
      {stay, excess} =
        port
        |> connections()
        |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
        |> Enum.map(fn {_address, pids} ->
          pids |> Enum.sort_by(&(&1 not in earlier)) |> Enum.split(most)
        end)
        |> Enum.unzip()

      {List.flatten(excess), stay |> List.flatten() |> MapSet.new()}
    else
      {[], MapSet.new()}
    end
  end

  defp connections(port) do
    for socket <- :erlang.ports(),
        :erlang.port_info(socket, :name) == {:name, ~c"tcp_inet"},
        {:ok, {_, ^port}} <- [:inet.sockname(socket)],
        {:ok, {address, _}} <- [:inet.peername(socket)],
        {:connected, pid} <- [:erlang.port_info(socket, :connected)],
        do: {address, pid}
  end
end
