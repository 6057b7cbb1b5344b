defmodule Situ.Bridge.Net.Listener do
  @moduledoc false
  # A listening port. `start_acceptor/2` starts the accepting process, which asks `server` for a process for each
  # connection (`:adopt`, with a pid or `:full` as the reply) and passes the connection to it as `{:adopt, tcp}`.
  alias Situ.Error

  @type t :: :gen_tcp.socket()

  @doc "Listens on an interface; `\"*\"` means all interfaces. Errors: `:address_in_use`, `:bad_address`."
  @spec listen(String.t(), :inet.port_number()) :: {:ok, t()} | {:error, Error.t()}
  def listen(interface, port) do
    options = [:binary, active: false, reuseaddr: true, backlog: 128]

    with {:ok, ip} <- resolve_interface(interface),
         {:ok, listener} <- :gen_tcp.listen(port, [ip: ip] ++ options) do
      {:ok, listener}
    else
      {:error, :eaddrinuse} ->
        {:error,
         Error.new(:address_in_use, "port #{port} of #{interface} is in use",
           fix: "choose another port, or stop the program that listens on it"
         )}

      {:error, reason} ->
        why = to_string(:inet.format_error(reason))
        {:error, Error.new(:bad_address, "cannot listen on #{interface}:#{port}", why: why)}
    end
  end

  defp resolve_interface("*"), do: {:ok, {0, 0, 0, 0}}
  defp resolve_interface(interface), do: :inet.getaddr(String.to_charlist(interface), :inet)

  @doc "Returns the port number."
  @spec port(t()) :: :inet.port_number()
  def port(listener), do: elem(:inet.port(listener), 1)

  @doc "Starts the accepting process, linked to the caller."
  @spec start_acceptor(t(), server :: pid()) :: pid()
  def start_acceptor(listener, server),
    do: spawn_link(fn -> accept_connections(listener, server) end)

  defp accept_connections(listener, server) do
    case :gen_tcp.accept(listener) do
      {:ok, tcp} ->
        hand_over_socket(tcp, GenServer.call(server, :adopt))
        accept_connections(listener, server)

      {:error, :emfile} ->
        Process.sleep(100)
        accept_connections(listener, server)

      {:error, _closed} ->
        :ok
    end
  end

  defp hand_over_socket(tcp, :full), do: :gen_tcp.close(tcp)

  defp hand_over_socket(tcp, connection) do
    with :ok <- :gen_tcp.controlling_process(tcp, connection), do: send(connection, {:adopt, tcp})
  end
end
