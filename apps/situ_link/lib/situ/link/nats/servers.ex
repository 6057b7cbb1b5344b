defmodule Situ.Link.Nats.Servers do
  @moduledoc false
  # Parses the addresses and the login of NATS servers.
  alias Situ.Error

  @doc "Parses an address into its hosts with ports, and the login that it contains."
  @spec parse(String.t()) ::
          {:ok, [{String.t(), :inet.port_number()}], map()} | {:error, Error.t()}
  def parse("nats://" <> rest = address) do
    {login, hosts} =
      case String.split(rest, "@", parts: 2) do
        [hosts] -> {%{}, hosts}
        [login, hosts] -> {split_login(login, &URI.decode/1), hosts}
      end

    servers = hosts |> String.split(",", trim: true) |> Enum.map(&parse_server/1)

    if servers == [] or :error in servers,
      do:
        {:error,
         Error.new(:bad_address, "invalid NATS address: #{redact_login(address)}",
           fix: "write nats://host:4222"
         )},
      else: {:ok, servers, login}
  end

  @doc "Returns the login of the address, or the login in the first line of a file."
  @spec resolve_login(map(), Path.t() | nil) :: {:ok, map()} | {:error, Error.t()}
  def resolve_login(login, nil), do: {:ok, login}

  def resolve_login(login, _file) when login != %{} do
    {:error,
     Error.new(:bad_option, "the address of the log and `credentials:` both contain a login",
       fix: "write nats://host:4222, and put the user and password only into the file"
     )}
  end

  def resolve_login(_none, file) do
    with {:ok, text} <- File.read(file),
         line when line != "" <- text |> String.split("\n") |> hd() |> String.trim() do
      {:ok, split_login(line, & &1)}
    else
      {:error, reason} -> {:error, no_credentials(file, to_string(:file.format_error(reason)))}
      "" -> {:error, no_credentials(file, "its first line is empty")}
    end
  end

  defp split_login(text, decode) do
    case text |> String.split(":", parts: 2) |> Enum.map(decode) do
      [user, password] -> %{"user" => user, "pass" => password}
      [token] -> %{"auth_token" => token}
    end
  end

  defp no_credentials(file, why) do
    Error.new(:no_credentials, "cannot read credentials from #{file}",
      why: why,
      fix: "write user:password, or a token, into its first line"
    )
  end

  defp parse_server(text) do
    case String.split(text, ":") do
      [host] when host != "" ->
        {host, 4222}

      [host, port] when host != "" ->
        with({n, ""} <- Integer.parse(port), do: {host, n}, else: (_ -> :error))

      _ ->
        :error
    end
  end

  defp redact_login(address), do: String.replace(address, ~r{//[^@]*@}, "//...@")

  @doc "Checks that `domain` is `nil` or the name of a JetStream domain."
  @spec validate_domain(String.t() | nil) :: :ok | {:error, Error.t()}
  def validate_domain(nil), do: :ok

  def validate_domain(domain) do
    if domain =~ ~r/\A[A-Za-z0-9_-]+\z/,
      do: :ok,
      else: {:error, Error.new(:bad_option, "invalid JetStream domain name: #{inspect(domain)}")}
  end
end
