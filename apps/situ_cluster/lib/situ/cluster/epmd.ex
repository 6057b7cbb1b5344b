defmodule Situ.Cluster.Epmd do
  @moduledoc false
  # Provides Erlang distribution without `epmd`, the daemon that knows every node's port. The name
  # of a node contains its port: `situ-9301@lab1.local` listens on port 9301.
  #
  #     elixir --name situ-9301@127.0.0.1 --erl "-start_epmd false -epmd_module Elixir.Situ.Cluster.Epmd -pa EBIN" ...
  #
  # A node whose name has no port (`iex@host`) listens on any free port. It can connect to other
  # nodes, but they cannot find it.
  # `epmd` would be another daemon, listening on all interfaces. A fixed port (`-erl_epmd_port`)
  # would allow only one node per machine. With the port in the name, a firewall needs one open
  # port per node.

  # The version of the distribution protocol, in the form that epmd reports it.
  @version 6

  @doc """
  Parses the port out of a node's name (without its host).

      iex> Situ.Cluster.Epmd.parse_port("situ-9301")
      {:ok, 9301}
      iex> Situ.Cluster.Epmd.parse_port("situ")
      :error
  """
  @spec parse_port(String.t()) :: {:ok, :inet.port_number()} | :error
  def parse_port(name) do
    with [_ | _] = parts <- String.split(name, "-"),
         {port, ""} when port in 1..65_535 <- Integer.parse(List.last(parts)) do
      {:ok, port}
    else
      _ -> :error
    end
  end

  # net_kernel and the distribution carriers call the following functions; see erl_epmd.

  @doc false
  def start_link, do: :ignore

  @doc false
  def register_node(name, port), do: register_node(name, port, :inet)
  @doc false
  def register_node(_name, _port, _family), do: {:ok, :rand.uniform(3)}

  @doc false
  def listen_port_please(name, _host) do
    case parse_port(to_string(name)) do
      {:ok, port} -> {:ok, port}
      :error -> {:ok, 0}
    end
  end

  @doc false
  def address_please(_name, host, family), do: :inet.getaddr(host, family)

  @doc false
  def port_please(name, host), do: port_please(name, host, :infinity)

  @doc false
  def port_please(name, _host, _timeout) do
    case parse_port(to_string(name)) do
      {:ok, port} -> {:port, port, @version}
      :error -> :noport
    end
  end

  @doc false
  def names(_host), do: {:error, :address}
end
