defmodule Situ.Store.S3.Opening do
  @moduledoc false
  # Finds a recording in object storage and prepares its mirror: one request for its current versions, and one for each
  # manifest that the cache does not have.
  # See docs/adr/0194-recordings-in-object-storage-are-read-through-mirrors.md.
  alias Situ.Error
  alias Situ.Store.Folder
  alias Situ.Store.S3.{Address, Cache, Client, Cost, Listing, Manifest, Mirror}

  # Manifests that are fetched at the same time.
  @parallel 8

  @doc "Returns the local path at which the recording of an address opens."
  @spec prepare(Address.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def prepare(%Address{} = address) do
    with {:ok, endpoint} <- fetch_endpoint(),
         {:ok, items} <- Listing.list_versions(address),
         {:ok, kind, chosen} <- choose_versions(items, address, endpoint),
         parent = Address.parent(address),
         set = Cache.set_folder([endpoint, parent.bucket, parent.key]),
         :ok <- make_set(set),
         :ok <- link_mirrors(set, chosen),
         :ok <- unlink_others(set, address, items) do
      {:ok, Path.join(set, local_name(kind, address, chosen))}
    end
  end

  @doc "Returns the address of the service, which identifies it in the cache."
  @spec fetch_endpoint() :: {:ok, String.t()} | {:error, Error.t()}
  def fetch_endpoint do
    with {:ok, {%{"endpoint" => endpoint}, _}} <- Client.request(%{op: "endpoint"}),
         do: {:ok, endpoint}
  end

  # A version opens alone, and a name opens its newest version or all of its segments.
  defp choose_versions([], address, _endpoint), do: {:error, missing_error(address)}

  defp choose_versions(items, address, endpoint) do
    exact = Enum.find(items, &(&1.name == Address.name(address)))
    newest = exact || List.last(items)

    if exact == nil and newest.segment?,
      do: prepare_segments(Enum.filter(items, & &1.segment?), endpoint),
      else:
        with(
          {:ok, mirror} <- prepare_mirror(newest, endpoint),
          do: {:ok, :single, [{newest, mirror}]}
        )
  end

  @doc "Returns the error for an address without a recording."
  @spec missing_error(Address.t()) :: Error.t()
  def missing_error(address) do
    Error.new(:no_store, "no recording at #{Address.format(address)}",
      why: "no finished recording has this name",
      fix:
        "`situ store list #{Address.format(Address.parent(address))}` lists the recordings there"
    )
  end

  defp prepare_segments(items, endpoint) do
    prepared =
      items
      |> Task.async_stream(
        &Cost.measure(fn -> {&1, prepare_mirror(&1, endpoint)} end),
        max_concurrency: @parallel,
        timeout: :infinity
      )
      |> Enum.map(fn {:ok, {result, cost}} ->
        Cost.add(cost)
        result
      end)

    case Enum.find(prepared, &match?({_, {:error, _}}, &1)) do
      {_, error} -> error
      nil -> {:ok, :segments, for({item, {:ok, mirror}} <- prepared, do: {item, mirror})}
    end
  end

  # The version of the manifest is part of the mirror's name, so an existing mirror is current.
  defp prepare_mirror(item, endpoint) do
    folder = Cache.object_folder([endpoint, item.address.bucket, item.manifest, item.etag])

    if Mirror.exists?(folder) do
      _ = File.touch(Path.join(folder, "mirror.json"))
      {:ok, folder}
    else
      create_mirror(folder, item)
    end
  end

  defp create_mirror(folder, item) do
    with {:ok, manifest} <- fetch_manifest(item),
         :ok <- make_set(Path.dirname(folder)),
         :ok <- Mirror.create(folder, manifest, item.address),
         do: {:ok, folder}
  end

  @doc "Fetches the manifest of a recording."
  @spec fetch_manifest(Listing.item()) :: {:ok, Manifest.t()} | {:error, Error.t()}
  def fetch_manifest(item) do
    command = %{
      op: "get",
      bucket: item.address.bucket,
      key: item.manifest,
      most: Manifest.max_bytes()
    }

    with {:ok, {_, bytes}} <- Client.request(command),
         do: Manifest.decode(bytes, Address.format(item.address))
  end

  @doc "Returns the id and the last originating time of a recording. They are cached."
  @spec fetch_facts(Listing.item()) ::
          {:ok, %{id: String.t(), last: Situ.Time.t() | nil}} | {:error, Error.t()}
  def fetch_facts(item) do
    with {:ok, endpoint} <- fetch_endpoint() do
      path = facts_path(item, endpoint)

      with {:ok, text} <- File.read(path),
           {:ok, %{"id" => id, "last" => last}} <- Situ.JSON.decode(text) do
        {:ok, %{id: id, last: last}}
      else
        _ -> fetch_and_keep_facts(item, path)
      end
    end
  end

  defp facts_path(item, endpoint),
    do: Cache.facts_path([endpoint, item.address.bucket, item.manifest, item.etag])

  defp fetch_and_keep_facts(item, path) do
    with {:ok, manifest} <- fetch_manifest(item) do
      facts = Map.take(manifest, [:id, :last])
      _ = Cache.make_folder(Path.dirname(path))
      _ = File.write(path, Situ.JSON.encode(facts))
      {:ok, facts}
    end
  end

  defp make_set(set) do
    with {:error, reason} <- Cache.make_folder(set),
         do: {:error, Folder.io_error("create the cache #{set}", reason)}
  end

  # A link is replaced by a rename, so that readers never find none.
  defp link_mirrors(set, chosen) do
    Enum.reduce_while(chosen, :ok, fn {item, mirror}, :ok ->
      case replace_link(Path.join(set, item.name), mirror) do
        :ok ->
          {:cont, :ok}

        {:error, reason} ->
          {:halt, {:error, Folder.io_error("write to the cache #{set}", reason)}}
      end
    end)
  end

  defp replace_link(link, mirror) do
    if File.read_link(link) == {:ok, mirror} do
      :ok
    else
      temporary = "#{link}-#{System.pid()}-#{System.unique_integer([:positive])}.tmp"

      with :ok <- File.ln_s(mirror, temporary), do: File.rename(temporary, link)
    end
  end

  # Versions that were deleted remotely must not open any more.
  defp unlink_others(set, address, items) do
    name = Address.name(address)
    names = MapSet.new(items, & &1.name)

    for path <- Folder.list_versions(name, set),
        Path.basename(path) not in names,
        do: File.rm(path)

    :ok
  end

  defp local_name(:single, _address, [{item, _}]), do: item.name
  defp local_name(:segments, address, _segments), do: Address.name(address)
end
