defmodule Situ.Store.S3 do
  @moduledoc """
  Recordings in object storage: any service with the S3 interface (AWS, MinIO, Garage, R2, Ceph ...).

  An address `s3://BUCKET/PREFIX/NAME` opens wherever a path does. `Situ.Store.open/2` fetches an index and then only
  the parts that are read, and keeps them in a cache:

      {:ok, store} = Situ.Store.open("s3://lab/recordings/lobby")
      {:ok, message} = Situ.Store.latest_at(store, "Lobby.Video", time)

  Recordings are written locally and then pushed. A recording appears when it is complete, and it never changes:

      {:ok, report} = Situ.Store.S3.push("recordings/lobby", "s3://lab/recordings/lobby")
      {:ok, report} = Situ.Store.S3.pull("s3://lab/recordings/lobby", "copies/lobby")
      {:ok, report} = Situ.Store.S3.sync("recordings", "s3://lab/recordings", keep: Situ.Time.h(24 * 30))

  Credentials, region and endpoint are set as for the AWS tools: `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`,
  `AWS_SESSION_TOKEN`, `AWS_REGION`, `AWS_ENDPOINT_URL`, or the profile `AWS_PROFILE` of `~/.aws/credentials` and
  `~/.aws/config`. An address never contains them.

  The program object_port (`bin/setup --with s3`) sends the requests. It is built on first use.

  One process, a child of the application's supervisor, owns the program. If the program crashes, requests in flight
  return the error `:object_port_ended`, and the next request starts it again.
  """
  @behaviour Situ.Recording.Format
  alias Situ.{Error, Options}
  alias Situ.Store.{Folder, NativeFormat}

  alias Situ.Store.S3.{
    Address,
    Listing,
    Mirror,
    Opening,
    Pull,
    Push,
    RecentListings,
    Retention,
    Transfer
  }

  @progress [
    progress: [
      type: {:fun, 2},
      doc: "Called with the number of bytes that are done and of all bytes."
    ]
  ]

  @keep [
    keep: [
      type: {:optional, :integer},
      doc:
        "Then delete the remote recordings of each name whose last message is this many ns older than the newest of " <>
          "the name. The newest is always kept."
    ]
  ]

  @list_options [
    recursive: [type: :boolean, default: false, doc: "Search subfolders, too."]
  ]

  @typedoc "The steps of a transfer, and its cost."
  @type report :: Transfer.report()

  # Format

  @impl true
  def extensions, do: []
  @impl true
  def schemes, do: ["s3"]

  @impl true
  def locate(address) do
    with {:ok, address} <- Address.parse(address), do: Opening.prepare(address)
  end

  @impl true
  def open(address, opts) do
    with {:ok, path} <- locate(address), do: NativeFormat.open(path, opts)
  end

  # An address of one recording lists it. The addresses in a bucket that does not respond are unknown. Pages ask several
  # times, so the result is remembered for some seconds.
  @impl true
  def list_recordings(address) do
    case RecentListings.fetch(address, fn -> list_or_find(address) end) do
      {:ok, addresses} -> addresses
      {:error, _} -> []
    end
  end

  defp list_or_find(address) do
    with {:ok, []} <- list(address),
         {:ok, target} <- Address.parse(address),
         {:ok, versions} <- Listing.list_versions(target),
         do: {:ok, if(versions == [], do: [], else: [address])}
  end

  # Copying

  @doc """
  Lists the addresses of the recordings in a folder of a bucket. The segments of a recording are listed as its name.
  Recordings that are still being pushed are not listed.

  #{Options.docs(@list_options)}
  """
  @spec list(String.t(), keyword()) :: {:ok, [String.t()]} | {:error, Error.t()}
  def list(address, opts \\ []) do
    opts = Options.validate!(opts, @list_options)

    with {:ok, folder} <- Address.parse(address),
         {:ok, items} <- list_items(folder, opts[:recursive]),
         do: {:ok, items |> Enum.map(&item_address/1) |> Enum.uniq()}
  end

  defp list_items(folder, true), do: Listing.list_recursively(folder)
  defp list_items(folder, false), do: Listing.list_folder(folder)

  defp item_address(%{segment?: false, address: address}), do: Address.format(address)

  defp item_address(%{address: address, name: name}),
    do: address |> Address.parent() |> Address.join(Folder.store_name(name)) |> Address.format()

  @doc """
  Uploads a finished store, or the finished segments of a recording. An address that ends with `/` is a folder, and the
  recording keeps its name. Numbers NNNN are kept. What is there already is not sent again, and an interrupted upload
  continues where it stopped.

  #{Options.docs(@progress)}
  """
  @spec push(Path.t(), String.t(), keyword()) :: {:ok, report()} | {:error, Error.t()}
  def push(path, address, opts \\ []) do
    opts = Options.validate!(opts, @progress)

    Transfer.run(fn ->
      with {:ok, target} <- parse_target(address, path),
           {:ok, jobs, unfinished} <- Push.plan_recording(path, target),
           do: Transfer.push_jobs(jobs, unfinished, opts[:progress])
    end)
  end

  # An address that ends with "/" is a folder, and a bucket is one, too.
  defp parse_target(address, path) do
    with {:ok, target} <- Address.parse(address) do
      if String.ends_with?(address, "/") or target.key == "",
        do: {:ok, Address.join(target, path |> Path.expand() |> Folder.store_name())},
        else: {:ok, target}
    end
  end

  @doc """
  Downloads a recording to `path`, ROOT/NAME; a path that ends with `/` is a folder. The copies have the same numbers
  NNNN and the same contents. An interrupted download continues where it stopped.

  #{Options.docs(@progress)}
  """
  @spec pull(String.t(), Path.t(), keyword()) :: {:ok, report()} | {:error, Error.t()}
  def pull(address, path, opts \\ []) do
    opts = Options.validate!(opts, @progress)

    Transfer.run(fn ->
      with {:ok, source} <- Address.parse(address),
           {:ok, items} <- list_wanted(source) do
        name =
          if String.ends_with?(path, "/"), do: Address.name(source), else: Path.basename(path)

        root = if String.ends_with?(path, "/"), do: path, else: Path.dirname(path)
        jobs = for item <- items, do: {item, local_folder(item, Path.expand(root), name)}
        Transfer.pull_jobs(jobs, opts[:progress])
      end
    end)
  end

  # Like opening: the recording itself, its newest version, or all of its segments.
  defp list_wanted(source) do
    with {:ok, items} <- Listing.list_versions(source) do
      exact = Enum.find(items, &(&1.name == Address.name(source)))

      cond do
        items == [] -> {:error, Opening.missing_error(source)}
        exact -> {:ok, [exact]}
        List.last(items).segment? -> {:ok, Enum.filter(items, & &1.segment?)}
        true -> {:ok, [List.last(items)]}
      end
    end
  end

  defp local_folder(item, root, name) do
    numbered? = Folder.version_number(item.name) != nil and Folder.version_number(name) == nil
    Path.join(root, if(numbered?, do: name <> Path.extname(item.name), else: name))
  end

  @doc """
  Copies all finished recordings of a folder that the other folder lacks. One of the two is an address.

  #{Options.docs(@progress ++ @keep)}
  """
  @spec sync(String.t(), String.t(), keyword()) :: {:ok, report()} | {:error, Error.t()}
  def sync(from, to, opts \\ []) do
    opts = Options.validate!(opts, @progress ++ @keep)

    Transfer.run(fn ->
      case {Address.parse(from), Address.parse(to)} do
        {{:error, _}, {:ok, target}} -> sync_up(Path.expand(from), target, opts)
        {{:ok, source}, {:error, _}} -> sync_down(source, Path.expand(to), opts)
        _ -> {:error, bad_sync_error()}
      end
    end)
  end

  defp bad_sync_error do
    Error.new(:bad_address, "sync copies between a local folder and an address",
      fix: "write `situ store sync FOLDER s3://BUCKET/PREFIX`, or the other way round"
    )
  end

  defp sync_up(root, target, opts) do
    paths = root |> Folder.list_stores(false) |> Enum.filter(&Folder.store_folder?/1)
    {finished, unfinished} = Enum.split_with(paths, &Push.finished?/1)

    with {:ok, items} <- Listing.list_folder(target),
         remote = Map.new(items, &{&1.name, &1}),
         {:ok, present, missing} <- split_present(finished, remote),
         jobs = for(path <- missing, do: {path, Address.join(target, Path.basename(path))}),
         {:ok, report} <- Transfer.push_jobs(jobs, unfinished, opts[:progress]),
         {:ok, deleted} <- Retention.delete_old(target, opts[:keep]) do
      known =
        for path <- present, do: target |> Address.join(Path.basename(path)) |> Address.format()

      {:ok, %{report | present: known ++ report.present, deleted: deleted}}
    end
  end

  defp split_present(paths, remote) do
    Enum.reduce_while(paths, {:ok, [], []}, fn path, {:ok, present, missing} ->
      case remote[Path.basename(path)] do
        nil -> {:cont, {:ok, present, [path | missing]}}
        item -> check_same(item, path, {present, missing})
      end
    end)
    |> case do
      {:ok, present, missing} -> {:ok, Enum.reverse(present), Enum.reverse(missing)}
      error -> error
    end
  end

  defp check_same(item, path, {present, missing}) do
    with {:ok, %{id: id}} <- Opening.fetch_facts(item) do
      if Pull.local_id(path) == id,
        do: {:cont, {:ok, [path | present], missing}},
        else: {:halt, {:error, Push.exists_error(item.address)}}
    else
      error -> {:halt, error}
    end
  end

  defp sync_down(source, root, opts) do
    with {:ok, items} <- Listing.list_folder(source) do
      Transfer.pull_jobs(
        for(item <- items, do: {item, Path.join(root, item.name)}),
        opts[:progress]
      )
    end
  end

  @doc """
  Deletes a recording, its newest version or all of its segments like `pull/3` copies them. Its manifest is deleted
  first, so readers never find a part of it.
  """
  @spec delete(String.t()) :: {:ok, report()} | {:error, Error.t()}
  def delete(address) do
    Transfer.run(fn ->
      with {:ok, source} <- Address.parse(address),
           {:ok, items} <- list_wanted(source),
           {:ok, deleted} <- Retention.delete_items(items),
           do: {:ok, %{Transfer.empty_report() | deleted: deleted}}
    end)
  end

  @doc "Returns the number of bytes of a remote recording that was opened from this path of the cache."
  @spec remote_bytes(Path.t()) :: non_neg_integer() | nil
  defdelegate remote_bytes(path), to: Mirror
end
