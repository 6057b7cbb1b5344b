defmodule Situ.Link.ServerName do
  @moduledoc false
  # Makes TLS clients verify that the certificate of a server names the host that they connect to.

  @doc """
  Returns the `:ssl.connect` options that make it compare a host with the names in the server's certificate.

  Erlang compares IP addresses with those in a certificate only if no server name is given.

      iex> Situ.Link.ServerName.tls_options("lab1")
      [server_name_indication: ~c"lab1"]
      iex> Situ.Link.ServerName.tls_options("10.0.0.3")
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
