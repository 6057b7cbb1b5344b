defmodule Situ.Studio.Tiles do
  @moduledoc false
  # Describes the source of map tiles. There is none unless the user names an address or a folder.
  # The page's content security policy allows tiles only from that origin, and requests contain
  # nothing but tile numbers.
  alias Situ.Error

  @enforce_keys [:url]
  defstruct [:url, :credit, :origin, :folder]

  @type t :: %__MODULE__{
          url: String.t(),
          credit: String.t() | nil,
          origin: String.t() | nil,
          folder: Path.t() | nil
        }

  @doc """
  Builds the tile source for an address or a folder of `{z}/{x}/{y}.png`. Errors: `:bad_tiles`.

      iex> {:ok, tiles} = Situ.Studio.Tiles.new("https://tile.example.org/{z}/{x}/{y}.png", "Example's maps")
      iex> {Situ.Studio.Tiles.allowed_origins(tiles), tiles.credit}
      {["https://tile.example.org"], "Example's maps"}
      iex> {:error, error} = Situ.Studio.Tiles.new("https://tile.example.org/", nil)
      iex> error.what
      "a map tile address must contain {z}, {x} and {y}: \\"https://tile.example.org/\\""
  """
  @spec new(String.t() | nil, String.t() | nil) :: {:ok, t() | nil} | {:error, Error.t()}
  def new(nil, _credit), do: {:ok, nil}

  def new(text, credit) do
    uri = URI.parse(text)

    cond do
      uri.scheme in ["http", "https"] and valid_host?(uri.host) ->
        from_address(text, uri, credit)

      File.dir?(text) ->
        {:ok, %__MODULE__{url: "/tiles/{z}/{x}/{y}.png", credit: credit, folder: text}}

      true ->
        tiles_error(
          "map tiles must be an existing folder or an http(s) address, not #{inspect(text)}"
        )
    end
  end

  # The host is written into a header, so it must not contain special characters.
  defp valid_host?(host), do: is_binary(host) and host =~ ~r/\A[A-Za-z0-9.-]+\z/

  defp from_address(text, uri, credit) do
    if Enum.all?(["{z}", "{x}", "{y}"], &String.contains?(text, &1)) do
      port = if uri.port in [80, 443, nil], do: "", else: ":#{uri.port}"
      {:ok, %__MODULE__{url: text, credit: credit, origin: "#{uri.scheme}://#{uri.host}#{port}"}}
    else
      tiles_error("a map tile address must contain {z}, {x} and {y}: #{inspect(text)}")
    end
  end

  defp tiles_error(what),
    do: {:error, Error.new(:bad_tiles, what, fix: "use the form https://.../{z}/{x}/{y}.png")}

  @doc "Returns the origins that tiles may be loaded from."
  @spec allowed_origins(t() | nil) :: [String.t()]
  def allowed_origins(%__MODULE__{origin: origin}) when origin != nil, do: [origin]
  def allowed_origins(_), do: []

  @doc "Returns the route that serves a folder of tiles, if any."
  @spec tile_routes(t() | nil) :: [tuple()]
  def tile_routes(%__MODULE__{folder: folder}) when folder != nil,
    do: [{:static, "/tiles", folder}]

  def tile_routes(_), do: []
end
