defmodule Situ.Studio.Tiles do
  @moduledoc """
  Where the pictures below maps come from: nowhere, unless the user names an address or a folder. A page fetches
  pictures from that one origin only (its content security policy says so), and tells it no more than the tiles'
  numbers.

      iex> {:ok, tiles} = Situ.Studio.Tiles.new("https://tile.example.org/{z}/{x}/{y}.png", "Example's maps")
      iex> {Situ.Studio.Tiles.origins(tiles), tiles.credit}
      {["https://tile.example.org"], "Example's maps"}
      iex> {:error, error} = Situ.Studio.Tiles.new("https://tile.example.org/", nil)
      iex> error.what
      "an address of map tiles needs {z}, {x} and {y}, not \\"https://tile.example.org/\\""
  """
  alias Situ.Error

  @enforce_keys [:url]
  defstruct [:url, :credit, :origin, :folder]

  @type t :: %__MODULE__{
          url: String.t(),
          credit: String.t() | nil,
          origin: String.t() | nil,
          folder: Path.t() | nil
        }

  @doc "The tiles at an address, or in a folder of `{z}/{x}/{y}.png`. Errors: `:bad_tiles`."
  @spec new(String.t() | nil, String.t() | nil) :: {:ok, t() | nil} | {:error, Error.t()}
  def new(nil, _credit), do: {:ok, nil}

  def new(text, credit) do
    uri = URI.parse(text)

    cond do
      uri.scheme in ["http", "https"] and plain?(uri.host) ->
        address(text, uri, credit)

      File.dir?(text) ->
        {:ok, %__MODULE__{url: "/tiles/{z}/{x}/{y}.png", credit: credit, folder: text}}

      true ->
        bad("map tiles come from a folder or an address, not #{inspect(text)}")
    end
  end

  # The host is written into a header.
  defp plain?(host), do: is_binary(host) and host =~ ~r/\A[A-Za-z0-9.-]+\z/

  defp address(text, uri, credit) do
    if Enum.all?(["{z}", "{x}", "{y}"], &String.contains?(text, &1)) do
      port = if uri.port in [80, 443, nil], do: "", else: ":#{uri.port}"
      {:ok, %__MODULE__{url: text, credit: credit, origin: "#{uri.scheme}://#{uri.host}#{port}"}}
    else
      bad("an address of map tiles needs {z}, {x} and {y}, not #{inspect(text)}")
    end
  end

  defp bad(what),
    do: {:error, Error.new(:bad_tiles, what, fix: "write it like https://.../{z}/{x}/{y}.png")}

  @doc "The origins that pictures may come from."
  @spec origins(t() | nil) :: [String.t()]
  def origins(%__MODULE__{origin: origin}) when origin != nil, do: [origin]
  def origins(_), do: []

  @doc "The route of a folder of tiles."
  @spec routes(t() | nil) :: [tuple()]
  def routes(%__MODULE__{folder: folder}) when folder != nil, do: [{:static, "/tiles", folder}]
  def routes(_), do: []
end
