defmodule Situ.Link.Address do
  @moduledoc false
  # Parses the address of a link: `situ://host:port/name`, `situs://...` (TLS), or
  # `situ+unix:///path/of/socket?name`.
  #
  # `situs://host/name?fingerprint=...` pins the server's certificate by its SHA-256 fingerprint
  # (64 hexadecimal digits). Any other certificate is rejected, even if a trusted authority signed
  # it. `bin/situ serve --tls` prints the full address.
  #
  # A host without a port is first looked up among the configured names:
  #
  #     config :situ_link, names: %{"lab1" => "situs://10.0.0.3:11500"}
  #
  # With `config :situ_link, nats: "nats://lab0:4222"` it is then looked up among the processes
  # that find one another over NATS (`Situ.Link.Rendezvous`). After that it is looked up as a DNS
  # service (`_situ._tcp.lab1`, SRV), using the system's resolver or `config :situ_link,
  # nameservers: [{{10, 0, 0, 53}, 53}]`. If none of these knows the name, it is used as a
  # hostname.
  alias Situ.Error
  alias Situ.Link.Rendezvous.NatsMember

  @default_port 11_411

  @enforce_keys [:transport]
  defstruct [:transport, :host, :port, :path, :fingerprint, name: ""]

  @type t :: %__MODULE__{
          transport: :tcp | :tls | :unix,
          host: String.t() | nil,
          port: :inet.port_number() | nil,
          path: Path.t() | nil,
          fingerprint: String.t() | nil,
          name: String.t()
        }

  @doc "Returns the port used when an address does not include one."
  @spec default_port() :: :inet.port_number()
  def default_port, do: @default_port

  @doc "Returns whether a term is a string with the scheme of a link address."
  @spec address?(term()) :: boolean()
  def address?(text) when is_binary(text),
    do: Enum.any?(~w(situ:// situs:// situ+unix://), &String.starts_with?(text, &1))

  def address?(_other), do: false

  @doc """
  Parses an address. Errors: `:bad_address`.

      iex> {:ok, address} = Situ.Link.Address.parse("situ://lab1:4000/lobby")
      iex> {address.transport, address.host, address.port, address.name}
      {:tcp, "lab1", 4000, "lobby"}
      iex> {:ok, address} = Situ.Link.Address.parse("situ+unix:///run/situ/lab?lobby")
      iex> {address.transport, address.path, address.name}
      {:unix, "/run/situ/lab", "lobby"}
      iex> {:error, error} = Situ.Link.Address.parse("http://lab1/")
      iex> error.code
      :bad_address
      iex> Situ.Link.Address.to_string(address)
      "situ+unix:///run/situ/lab?lobby"
  """
  @spec parse(String.t()) :: {:ok, t()} | {:error, Error.t()}
  def parse(text) when is_binary(text) do
    uri = URI.parse(text)

    case {uri.scheme, uri.host, uri.path} do
      {"situ+unix", _, "/" <> _ = path} ->
        {:ok, %__MODULE__{transport: :unix, path: path, name: URI.decode(uri.query || "")}}

      {scheme, host, path} when scheme in ["situ", "situs"] and host not in [nil, ""] ->
        transport = if scheme == "situ", do: :tcp, else: :tls
        name = path |> Kernel.||("") |> String.trim_leading("/") |> URI.decode()
        address = %__MODULE__{transport: transport, host: host, port: uri.port, name: name}
        put_fingerprint(address, uri.query, text)

      _ ->
        {:error, address_error(text)}
    end
  rescue
    _ in [ArgumentError, URI.Error] -> {:error, address_error(text)}
  end

  defp put_fingerprint(address, nil, _text), do: {:ok, address}

  defp put_fingerprint(%{transport: :tls} = address, "fingerprint=" <> digits, text) do
    digits = digits |> URI.decode() |> String.replace(":", "") |> String.downcase()

    if digits =~ ~r/\A[0-9a-f]{64}\z/,
      do: {:ok, %{address | fingerprint: digits}},
      else: {:error, address_error(text)}
  end

  defp put_fingerprint(_address, _query, text), do: {:error, address_error(text)}

  defp address_error(text) do
    Error.new(:bad_address, "invalid link address: #{inspect(text)}",
      fix: "write situ://HOST:PORT/NAME, situs://... for TLS, or situ+unix:///PATH?NAME"
    )
  end

  @doc "Formats the address. If it has no name, the result is the address of the server."
  @spec to_string(t()) :: String.t()
  def to_string(%__MODULE__{transport: :unix} = address) do
    query = if address.name == "", do: "", else: "?" <> URI.encode(address.name)
    "situ+unix://#{address.path}#{query}"
  end

  def to_string(%__MODULE__{} = address) do
    scheme = if address.transport == :tls, do: "situs", else: "situ"
    host = if String.contains?(address.host, ":"), do: "[#{address.host}]", else: address.host
    port = if address.port, do: ":#{address.port}", else: ""
    name = if address.name == "", do: "", else: "/" <> URI.encode(address.name)
    pin = if address.fingerprint, do: "?fingerprint=" <> address.fingerprint, else: ""
    "#{scheme}://#{host}#{port}#{name}#{pin}"
  end

  @doc "Resolves the host of an address and fills in the port, so that the result can be connected to."
  @spec resolve(t(), map()) :: {:ok, t()} | {:error, Error.t()}
  def resolve(address, names \\ Application.get_env(:situ_link, :names, %{}))
  def resolve(%__MODULE__{transport: :unix} = address, _names), do: {:ok, address}
  def resolve(%__MODULE__{port: port} = address, _names) when port != nil, do: {:ok, address}

  def resolve(%__MODULE__{host: host} = address, names) do
    case names[host] || find_announced(host) do
      nil -> {:ok, resolve_service(address)}
      text -> resolve_configured(address, text)
    end
  end

  # If the NATS server is unreachable, the host can still be found by DNS or as a hostname.
  defp find_announced(host) do
    server = Application.get_env(:situ_link, :nats)
    if server != nil and not local_or_numeric?(host), do: NatsMember.find_address(server, host)
  end

  defp resolve_configured(address, text) do
    with {:ok, found} <- parse(text) do
      name = if address.name == "", do: found.name, else: address.name
      port = found.port || if(found.transport == :unix, do: nil, else: @default_port)
      pin = address.fingerprint || found.fingerprint
      {:ok, %{found | name: name, port: port, fingerprint: pin}}
    end
  end

  # SRV records with the lowest priority number are preferred and, among equals, the one with the largest weight.
  defp resolve_service(%{host: host} = address) do
    with false <- local_or_numeric?(host),
         [_ | _] = found <-
           :inet_res.lookup(
             ~c"_situ._tcp." ++ String.to_charlist(host),
             :in,
             :srv,
             nameserver_options()
           ) do
      {_, _, port, target} =
        Enum.min_by(found, fn {priority, weight, _, _} -> {priority, -weight} end)

      %{address | host: Kernel.to_string(target), port: port}
    else
      _ -> %{address | port: @default_port}
    end
  end

  defp nameserver_options do
    case Application.get_env(:situ_link, :nameservers) do
      nil -> []
      servers -> [nameservers: servers]
    end
  end

  # DNS has no service records for localhost or for numeric addresses.
  defp local_or_numeric?("localhost"), do: true

  defp local_or_numeric?(host),
    do: match?({:ok, _}, host |> String.to_charlist() |> :inet.parse_address())
end
