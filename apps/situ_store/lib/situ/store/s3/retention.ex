defmodule Situ.Store.S3.Retention do
  @moduledoc false
  # Deletes remote recordings, or the old recordings of each name.
  alias Situ.Error
  alias Situ.Store.Folder
  alias Situ.Store.S3.{Address, Client, Listing, Opening}

  @doc """
  Deletes the recordings of each name in a folder whose last message is `keep` ns older than the newest message. Returns
  the addresses of the deleted ones.
  """
  @spec delete_old(Address.t(), Situ.Time.duration() | nil) ::
          {:ok, [String.t()]} | {:error, Error.t()}
  def delete_old(_folder, nil), do: {:ok, []}

  def delete_old(folder, keep) do
    with {:ok, items} <- Listing.list_folder(folder),
         {:ok, dated} <- date_items(items) do
      dated
      |> Enum.group_by(fn {item, _} -> Folder.store_name(item.name) end)
      |> Enum.flat_map(fn {_, group} -> choose_old(group, keep) end)
      |> Enum.sort_by(& &1.address.key)
      |> delete_items()
    end
  end

  defp date_items(items) do
    Enum.reduce_while(items, {:ok, []}, fn item, {:ok, dated} ->
      case Opening.fetch_facts(item) do
        {:ok, %{last: last}} -> {:cont, {:ok, [{item, last} | dated]}}
        error -> {:halt, error}
      end
    end)
  end

  @doc """
  Chooses the items that are too old. Items without messages are kept.

      iex> Situ.Store.S3.Retention.choose_old([{:a, 10}, {:b, 25}, {:c, 30}], 10)
      [:a]
  """
  @spec choose_old([{item, Situ.Time.t() | nil}], Situ.Time.duration()) :: [item]
        when item: term()
  def choose_old(dated, keep) do
    newest = for({_, last} <- dated, last != nil, do: last) |> Enum.max(fn -> nil end)
    for {item, last} <- dated, last != nil, newest - last > keep, do: item
  end

  @doc "Deletes recordings: first their manifests, then their files. Returns their addresses."
  @spec delete_items([Listing.item()]) :: {:ok, [String.t()]} | {:error, Error.t()}
  def delete_items(items) do
    Enum.reduce_while(items, {:ok, []}, fn item, {:ok, deleted} ->
      case delete_item(item) do
        :ok -> {:cont, {:ok, deleted ++ [Address.format(item.address)]}}
        error -> {:halt, error}
      end
    end)
  end

  defp delete_item(%{address: %{bucket: bucket, key: key}} = item) do
    with {:ok, _} <- Client.request(%{op: "delete", bucket: bucket, keys: [item.manifest]}),
         {:ok, {%{"objects" => objects}, _}} <-
           Client.request(%{op: "list", bucket: bucket, prefix: key <> "/", folders: false}),
         keys = Enum.map(objects, & &1["key"]),
         {:ok, _} <- Client.request(%{op: "delete", bucket: bucket, keys: keys}),
         do: :ok
  end
end
