defmodule Situ.Remote.ServerName do
  @moduledoc false
  # How a client of TLS checks that a server's certificate names the host that it has called.

  @doc """
  Returns the options of `:ssl.connect` that make it compare a host with the names in the server's certificate.

  Erlang looks for an address among the addresses of a certificate only when no name was given.

      iex> Situ.Remote.ServerName.tls_options("lab1")
      [server_name_indication: ~c"lab1"]
      iex> Situ.Remote.ServerName.tls_options("10.0.0.3")
      []
  """
  @spec tls_options(String.t()) :: keyword()
  def tls_options(host) do
    name = String.to_charlist(host)

    case :inet.parse_address(name) do
      {:ok, _address} -> []
      {:error, _} -> [server_name_indication: name]
    end
  end
end
