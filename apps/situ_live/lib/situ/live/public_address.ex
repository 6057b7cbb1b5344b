defmodule Situ.Live.PublicAddress do
  @moduledoc false
  # The address under which browsers reach a server through a proxy. The proxy terminates TLS and
  # may add a path; `public:` gives the server the resulting address, or `prefix:` only its path.
  alias Situ.Error

  @enforce_keys [:base, :segments]
  defstruct [:url, :origin, :host, :base, :segments, secure?: false]

  @typedoc "`base` is the path without a trailing slash: empty, or `/studio`; `segments` are its parts."
  @type t :: %__MODULE__{
          url: String.t() | nil,
          origin: String.t() | nil,
          host: String.t() | nil,
          base: String.t(),
          segments: [String.t()],
          secure?: boolean()
        }

  @doc """
  Parses a public address, or `nil` for a server without one. Returns a `:bad_public` error if it
  is invalid.

      iex> {:ok, public} = Situ.Live.PublicAddress.parse("https://lab.example.org:8443/studio/")
      iex> {public.origin, public.base, public.segments}
      {"https://lab.example.org:8443", "/studio", ["studio"]}
      iex> {:error, error} = Situ.Live.PublicAddress.parse("lab.example.org")
      iex> error.code
      :bad_public
  """
  @spec parse(term()) :: {:ok, t() | nil} | {:error, Error.t()}
  def parse(nil), do: {:ok, nil}

  def parse(text) when is_binary(text) do
    with %URI{scheme: scheme, host: host, query: nil, fragment: nil, userinfo: nil} = uri
         when scheme in ["http", "https"] and host not in [nil, ""] <- URI.parse(text),
         {:ok, segments} <- split_path(uri.path || "") do
      {:ok, from_parts(scheme, String.downcase(host), uri.port, segments)}
    else
      _ -> address_error(text)
    end
  end

  def parse(other), do: address_error(other)

  @doc """
  Parses a path under which a proxy serves the server, or `nil`. Returns a `:bad_prefix` error if it is invalid.

      iex> {:ok, public} = Situ.Live.PublicAddress.parse_prefix("/lab/situ/")
      iex> {public.base, public.host}
      {"/lab/situ", nil}
      iex> {:error, error} = Situ.Live.PublicAddress.parse_prefix("a b")
      iex> error.code
      :bad_prefix
  """
  @spec parse_prefix(term()) :: {:ok, t() | nil} | {:error, Error.t()}
  def parse_prefix(nil), do: {:ok, nil}

  def parse_prefix("/" <> _ = path) do
    case split_path(path) do
      {:ok, segments} -> {:ok, %__MODULE__{base: join_path(segments), segments: segments}}
      :error -> prefix_error(path)
    end
  end

  def parse_prefix(other), do: prefix_error(other)

  defp prefix_error(value) do
    {:error,
     Error.new(:bad_prefix, "invalid path prefix: #{inspect(value, printable_limit: 100)}",
       why: "a prefix starts with / and consists of letters, digits, and the characters . ~ _ -",
       fix: "write it like /situ"
     )}
  end

  defp split_path(path) do
    segments = String.split(path, "/", trim: true)

    if Enum.all?(segments, &(&1 =~ ~r/\A[\w.~-]+\z/ and &1 not in [".", ".."])),
      do: {:ok, segments},
      else: :error
  end

  defp join_path(segments), do: Enum.map_join(segments, &("/" <> &1))

  defp from_parts(scheme, host, port, segments) do
    default_port = URI.default_port(scheme)
    authority = if String.contains?(host, ":"), do: "[#{host}]", else: host
    origin = "#{scheme}://#{authority}#{if port != default_port, do: ":#{port}"}"
    base = join_path(segments)

    %__MODULE__{
      url: origin <> base,
      origin: origin,
      host: host,
      base: base,
      segments: segments,
      secure?: scheme == "https"
    }
  end

  defp address_error(text) do
    {:error,
     Error.new(
       :bad_public,
       "invalid server address: #{inspect(text, limit: 5, printable_limit: 100)}",
       fix: "write it like https://lab.example.org/studio"
     )}
  end

  @doc "Returns the origins that the public address allows."
  @spec allowed_origins(t() | nil) :: [String.t()]
  def allowed_origins(public), do: if(public && public.origin, do: [public.origin], else: [])

  @doc "Returns the host names that the public address allows."
  @spec allowed_hosts(t() | nil) :: [String.t()]
  def allowed_hosts(public), do: if(public && public.host, do: [public.host], else: [])

  @doc "Returns the prefix of every path in the pages."
  @spec base_path(t() | nil) :: String.t()
  def base_path(nil), do: ""
  def base_path(public), do: public.base

  @doc """
  Removes the proxy's path from the segments of a request, unless the proxy has already removed it.

      iex> {:ok, public} = Situ.Live.PublicAddress.parse("https://lab.example.org/studio")
      iex> Situ.Live.PublicAddress.strip_base(public, ["studio", "s", "x"])
      ["s", "x"]
      iex> Situ.Live.PublicAddress.strip_base(public, ["s", "x"])
      ["s", "x"]
  """
  @spec strip_base(t() | nil, [String.t()]) :: [String.t()]
  def strip_base(nil, segments), do: segments

  def strip_base(%{segments: base}, segments) do
    if base != [] and List.starts_with?(segments, base),
      do: Enum.drop(segments, length(base)),
      else: segments
  end
end
