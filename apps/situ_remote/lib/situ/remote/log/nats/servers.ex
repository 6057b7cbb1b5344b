defmodule Situ.Remote.Log.Nats.Servers do
  @moduledoc false
  # Where servers are and how to log in, from text.
  alias Situ.Error

  @doc "Hosts with ports, and what the login is."
  @spec parse(String.t()) ::
          {:ok, [{String.t(), :inet.port_number()}], map()} | {:error, Error.t()}
  def parse("nats://" <> rest = address) do
    {login, hosts} =
      case String.split(rest, "@", parts: 2) do
        [hosts] -> {%{}, hosts}
        [login, hosts] -> {login(String.split(login, ":", parts: 2)), hosts}
      end

    servers = hosts |> String.split(",", trim: true) |> Enum.map(&server/1)

    if servers == [] or :error in servers,
      do:
        {:error,
         Error.new(:bad_address, "not an address: #{redacted(address)}",
           fix: "write nats://host:4222"
         )},
      else: {:ok, servers, login}
  end

  defp login([user, password]), do: %{"user" => URI.decode(user), "pass" => URI.decode(password)}
  defp login([token]), do: %{"auth_token" => URI.decode(token)}

  defp server(text) do
    case String.split(text, ":") do
      [host] when host != "" ->
        {host, 4222}

      [host, port] when host != "" ->
        with({n, ""} <- Integer.parse(port), do: {host, n}, else: (_ -> :error))

      _ ->
        :error
    end
  end

  defp redacted(address), do: String.replace(address, ~r{//[^@]*@}, "//...@")

  @doc "Whether this is the name of a domain, or none."
  @spec domain(String.t() | nil) :: :ok | {:error, Error.t()}
  def domain(nil), do: :ok

  def domain(domain) do
    if domain =~ ~r/\A[A-Za-z0-9_-]+\z/,
      do: :ok,
      else: {:error, Error.new(:bad_option, "not the name of a domain: #{inspect(domain)}")}
  end
end
