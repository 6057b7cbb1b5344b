defmodule Situ.Store.S3.Listing do
  @moduledoc false
  # Lists the recordings in a folder of a bucket. Only their manifests count, so a recording that is still being pushed
  # is not listed.
  alias Situ.Error
  alias Situ.Store.Folder
  alias Situ.Store.S3.{Address, Client}

  # The manifest of a segment has another suffix, so that a listing shows which recordings are segments.
  @suffix ".situ"
  @segment_suffix ".segment"
  # The files of a recording are objects, too.
  @data_file ~r"/(data|large)-\d{6,}\.situ\z"

  @typedoc "`name` is the recording's folder, NAME or NAME.NNNN; `manifest` is the object and `etag` its version."
  @type item :: %{
          address: Address.t(),
          name: String.t(),
          manifest: String.t(),
          etag: String.t() | nil,
          segment?: boolean()
        }

  @doc "Lists the recordings in a folder, sorted by name."
  @spec list_folder(Address.t()) :: {:ok, [item()]} | {:error, Error.t()}
  def list_folder(%Address{key: ""} = folder), do: list_prefix(folder, "")
  def list_folder(%Address{key: key} = folder), do: list_prefix(folder, key <> "/")

  @doc "Lists the recordings in a folder and its subfolders."
  @spec list_recursively(Address.t()) :: {:ok, [item()]} | {:error, Error.t()}
  def list_recursively(%Address{key: ""} = folder), do: list_objects(folder, "", false)
  def list_recursively(%Address{key: key} = folder), do: list_objects(folder, key <> "/", false)

  @doc "Lists the recording at an address and its versions NAME.NNNN, oldest first."
  @spec list_versions(Address.t()) :: {:ok, [item()]} | {:error, Error.t()}
  def list_versions(%Address{key: ""}), do: {:ok, []}

  def list_versions(%Address{} = address) do
    name = Address.name(address)

    with {:ok, items} <- list_prefix(Address.parent(address), address.key <> ".") do
      found = for item <- items, item.name == name or version_of?(item.name, name), do: item
      {:ok, Enum.sort_by(found, &(Folder.version_number(&1.name) || -1))}
    end
  end

  defp version_of?(item, name),
    do: Folder.version_number(item) != nil and Folder.store_name(item) == name

  defp list_prefix(folder, prefix), do: list_objects(folder, prefix, true)

  defp list_objects(folder, prefix, folders?) do
    command = %{op: "list", bucket: folder.bucket, prefix: prefix, folders: folders?}

    with {:ok, {%{"objects" => objects}, _}} <- Client.request(command) do
      items =
        for %{"key" => key} = object <- objects,
            suffix = Path.extname(key),
            suffix in [@suffix, @segment_suffix],
            not (key =~ @data_file),
            {:ok, address} <- [parse_key(folder.bucket, Path.rootname(key, suffix))] do
          %{
            address: address,
            name: Address.name(address),
            manifest: key,
            etag: object["etag"],
            segment?: suffix == @segment_suffix
          }
        end

      {:ok, Enum.sort_by(items, & &1.address.key)}
    end
  end

  defp parse_key(bucket, key), do: Address.parse("s3://#{bucket}/#{key}")

  @doc "Returns the key of the manifest of a recording or a segment."
  @spec manifest_key(Address.t(), boolean()) :: String.t()
  def manifest_key(%Address{key: key}, segment?),
    do: key <> if(segment?, do: @segment_suffix, else: @suffix)
end
