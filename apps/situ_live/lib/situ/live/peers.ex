defmodule Situ.Live.Peers do
  @moduledoc false
  # Who holds the connections of a port. The web server bounds how many there are, not who holds them: one peer that
  # opens all of them would keep everybody else out, before it has sent a byte. So they are counted from outside.

  # Half of what the web server takes.
  @most 1_000

  @doc "The processes of connections beyond what one address may hold of a port."
  @spec excess(:inet.port_number(), pos_integer()) :: [pid()]
  def excess(port, most \\ @most) do
    # Looking costs a few microseconds a connection; with few there is nothing to see.
    if :erlang.system_info(:port_count) > most do
      port
      |> connections()
      |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
      |> Enum.flat_map(fn {_address, pids} -> Enum.drop(pids, most) end)
    else
      []
    end
  end

  defp connections(port) do
    for socket <- :erlang.ports(),
        :erlang.port_info(socket, :name) == {:name, ~c"tcp_inet"},
        {:ok, {_, ^port}} <- [:inet.sockname(socket)],
        {:ok, {address, _}} <- [:inet.peername(socket)],
        {:connected, pid} <- [:erlang.port_info(socket, :connected)],
        # In order of age: those that came first stay.
        do: {address, pid}
  end
end
