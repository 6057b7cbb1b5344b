defmodule Situ.Studio.RemoteItems do
  @moduledoc false
  # The recordings of servers that a user connects the studio to. The token of a server is only here, in no address.
  alias Situ.{Error, Link}
  alias Situ.Studio.Catalog.Item
  alias Situ.Studio.Stores

  @typedoc "Items by their ids, each with the options of its reader."
  @type t :: %{String.t() => {Item.t(), keyword()}}

  @doc "Finds the items of a server, or of a single recording."
  @spec find_items(String.t(), token :: String.t()) :: {:ok, t()} | {:error, Error.t()}
  def find_items(address, token) do
    opts = if token == "", do: [], else: [token: token]

    with {:ok, addresses} <- Link.list_recordings(String.trim(address), opts) do
      case addresses do
        [] -> {:error, no_recordings(address)}
        _ -> {:ok, Map.new(addresses, &build_entry(&1, opts))}
      end
    end
  end

  @spec get_item(t(), String.t()) :: Item.t() | nil
  def get_item(items, id), do: with({item, _opts} <- items[id], do: item)

  @spec list_items(t()) :: [Item.t()]
  def list_items(items), do: for({_id, {item, _opts}} <- Enum.sort(items), do: item)

  @spec reader_options(t(), String.t()) :: keyword()
  def reader_options(items, id), do: items |> Map.get(id, {nil, []}) |> elem(1)

  # The id consists of the server and the name: "lab1:11500/lobby".
  defp build_entry(address, opts) do
    name = Stores.address_name(address)
    server = server_name(URI.parse(address))
    id = "#{server}/#{name}"
    {id, {%Item{id: id, title: "#{name} of #{server}", kind: :elsewhere, path: address}, opts}}
  end

  defp server_name(%URI{scheme: "situ+unix", path: path}), do: Path.basename(path)
  defp server_name(%URI{host: host, port: nil}), do: host
  defp server_name(%URI{host: host, port: port}), do: "#{host}:#{port}"

  defp no_recordings(address) do
    Error.new(:not_found, "#{address} serves no recordings",
      fix: "serve some on that machine: situ serve recordings"
    )
  end
end
