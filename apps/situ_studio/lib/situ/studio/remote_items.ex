defmodule Situ.Studio.RemoteItems do
  @moduledoc false
  # Finds the recordings of a server that a user connects the studio to.
  alias Situ.{Error, Link}
  alias Situ.Studio.Catalog.Item
  alias Situ.Studio.Stores

  @doc "Returns the items of a server or of one of its recordings, each with the options of its reader."
  @spec find_items(String.t(), token :: String.t()) ::
          {:ok, [{Item.t(), keyword()}]} | {:error, Error.t()}
  def find_items(address, token) do
    opts = if token == "", do: [], else: [token: token]

    with {:ok, addresses} <- Link.list_recordings(String.trim(address), opts) do
      case addresses do
        [] -> {:error, no_recordings(address)}
        _ -> {:ok, for(found <- addresses, do: {build_item(found), opts})}
      end
    end
  end

  # The id consists of the server and the name: "lab1:11500/lobby".
  defp build_item(address) do
    name = Stores.address_name(address)
    server = server_name(URI.parse(address))
    %Item{id: "#{server}/#{name}", title: "#{name} of #{server}", kind: :elsewhere, path: address}
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
