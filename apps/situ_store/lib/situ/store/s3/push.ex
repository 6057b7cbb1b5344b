defmodule Situ.Store.S3.Push do
  @moduledoc false
  # Uploads finished local stores. The manifest is written last, so readers find either the whole recording or none. An
  # interrupted upload continues: object_port remembers the parts of a file, and this module the files.
  # See docs/adr/0195-a-manifest-makes-uploaded-files-a-recording.md.
  alias Situ.Error
  alias Situ.Store.{Folder, NativeErrors, NativeFormat, Query, Segments}

  alias Situ.Store.S3.{
    Address,
    Cache,
    Client,
    FileSums,
    Listing,
    Manifest,
    Opening,
    OpeningBlocks
  }

  @type progress :: (done :: non_neg_integer(), total :: non_neg_integer() -> any())
  @typedoc "A finished store, and its address."
  @type job :: {Path.t(), Address.t()}

  @doc """
  Lists the finished stores at a local path with their addresses. Returns the paths that are not finished, too. `path`
  is a store, or a name that stands for its newest version or for all of its segments.
  """
  @spec plan_recording(Path.t(), Address.t()) ::
          {:ok, [job()], [Path.t()]} | {:error, Error.t()}
  def plan_recording(path, address) do
    path = Path.expand(path)

    with {:ok, folders} <- find_folders(path) do
      {finished, others} = Enum.split_with(folders, &finished?/1)

      if finished == [],
        do: {:error, unfinished_error(hd(others))},
        else: {:ok, Enum.map(finished, &{&1, store_address(&1, address)}), others}
    end
  end

  defp find_folders(path) do
    cond do
      Segments.segmented?(path) -> {:ok, Segments.list_folders(path)}
      folder = existing_store(path) -> {:ok, [folder]}
      File.regular?(path) -> {:error, other_format_error(path)}
      true -> {:error, NativeErrors.to_error(:no_store, path)}
    end
  end

  defp existing_store(path) do
    folder = Folder.resolve_store(path)
    if folder && Folder.store_folder?(folder), do: folder
  end

  defp other_format_error(path) do
    Error.new(:unknown_format, "#{path} is not a store",
      why: "only Situ's own recordings can be read in pieces from object storage",
      fix: "`situ store copy #{path} NAME` makes a store of it"
    )
  end

  @doc "Returns whether the store in a folder was closed by its writer."
  @spec finished?(Path.t()) :: boolean()
  def finished?(folder) do
    with {:ok, state} <- NativeFormat.open(folder, []),
         %{closed?: closed?, live?: live?} <- NativeFormat.info(state),
         do: closed? and not live?,
         else: (_ -> false)
  rescue
    Error -> false
  end

  defp unfinished_error(folder) do
    Error.new(:not_closed, "the recording #{folder} is not finished",
      why: "its writer is running or was killed, and only finished recordings are pushed",
      fix: "wait until it ends, or close it with `situ store repair #{folder}`"
    )
  end

  # A store keeps its number NNNN, unless the address contains one.
  defp store_address(folder, address) do
    name = Address.name(address)

    case Folder.version_number(folder) do
      number when number != nil ->
        if Folder.version_number(name) == nil do
          digits = folder |> Path.extname()
          %{address | key: address.key <> digits}
        else
          address
        end

      nil ->
        address
    end
  end

  @doc "Uploads a finished store. Returns `:present` if the address has the same store already."
  @spec push_store(Path.t(), Address.t(), progress()) ::
          {:ok, :copied | :present} | {:error, Error.t()}
  def push_store(folder, address, progress) do
    with {:ok, files} <- FileSums.read(folder),
         {:ok, manifest, index} <- build_manifest(folder, files),
         {:ok, endpoint} <- Opening.fetch_endpoint(),
         {:ok, present?} <- check_present(address, manifest) do
      if present? do
        progress.(manifest.bytes, manifest.bytes)
        {:ok, :present}
      else
        upload_store(folder, address, {manifest, files, index}, endpoint, progress)
      end
    end
  end

  defp build_manifest(folder, files) do
    with {:ok, state} <- NativeFormat.open(folder, []),
         {:ok, index} <- read_index(folder) do
      info = NativeFormat.info(state)
      span = state |> NativeFormat.streams() |> Query.interval() || {nil, nil}

      manifest = %Manifest{
        name: Path.basename(folder),
        id: info.id,
        created: info.created,
        first: elem(span, 0),
        last: elem(span, 1),
        segment?: info.piece != nil,
        bytes: byte_size(index) + Enum.sum(Enum.map(files, & &1.size)),
        files:
          for(file <- files, do: %{name: file.name, size: file.size, crc: file.crc, etag: nil})
      }

      {:ok, manifest, index}
    end
  end

  defp read_index(folder) do
    path = Path.join(folder, "index.situ")

    with {:error, reason} <- File.read(path),
         do: {:error, Folder.io_error("read #{path}", reason)}
  end

  defp check_present(address, manifest) do
    with {:ok, items} <- Listing.list_versions(address) do
      case Enum.find(items, &(&1.address == address)) do
        nil -> {:ok, false}
        item -> compare_manifests(Opening.fetch_manifest(item), manifest, address)
      end
    end
  end

  defp compare_manifests({:ok, remote}, manifest, address) do
    if remote.id == manifest.id and list_contents(remote) == list_contents(manifest),
      do: {:ok, true},
      else: {:error, exists_error(address)}
  end

  defp compare_manifests(error, _manifest, _address), do: error

  defp list_contents(manifest),
    do: for(file <- manifest.files, do: {file.name, file.size, file.crc})

  @doc "Returns the error for an address that has another recording."
  @spec exists_error(Address.t()) :: Error.t()
  def exists_error(address) do
    Error.new(:store_exists, "#{Address.format(address)} is another recording",
      why: "a recording in object storage is never replaced, because others may be reading it",
      fix:
        "push to another name, or delete it with `situ store delete #{Address.format(address)}`"
    )
  end

  defp upload_store(folder, address, {manifest, files, index}, endpoint, progress) do
    journal = Cache.journal_path([endpoint, address.bucket, address.key, manifest.id])
    done = :counters.new(1, [])

    report = fn bytes ->
      :counters.add(done, 1, bytes)
      progress.(:counters.get(done, 1), manifest.bytes)
    end

    with :ok <- make_folder(Path.dirname(journal)),
         {:ok, earlier} <- find_uploaded(journal, address),
         {:ok, uploaded} <-
           upload_files(folder, address, {manifest.files, earlier}, journal, report) do
      parts =
        [{:index, index} | for(file <- files, do: {:sums, file.name, file.sums})] ++
          for {file, first, bytes} <- OpeningBlocks.read(folder, index),
              do: {:blocks, file, first, bytes}

      finish_upload(address, %{manifest | files: uploaded, parts: parts}, journal, fn ->
        report.(byte_size(index))
      end)
    end
  end

  defp make_folder(folder) do
    with {:error, reason} <- Cache.make_folder(folder),
         do: {:error, Folder.io_error("create the folder #{folder}", reason)}
  end

  # A file counts as uploaded if the journal and the service agree about it.
  defp find_uploaded(journal, address) do
    case read_journal(journal <> ".files") do
      [] ->
        {:ok, %{}}

      lines ->
        command = %{
          op: "list",
          bucket: address.bucket,
          prefix: address.key <> "/",
          folders: false
        }

        with {:ok, {%{"objects" => objects}, _}} <- Client.request(command) do
          etags = Map.new(objects, &{Path.basename(&1["key"]), &1["etag"]})

          {:ok,
           for(
             %{"name" => name, "etag" => etag} = line <- lines,
             etags[name] == etag,
             into: %{},
             do: {name, line}
           )}
        end
    end
  end

  defp read_journal(path) do
    case File.read(path) do
      {:ok, text} ->
        for line <- String.split(text, "\n", trim: true),
            {:ok, %{"name" => _, "etag" => _} = value} <- [Situ.JSON.decode(line)],
            do: value

      {:error, _} ->
        []
    end
  end

  defp upload_files(folder, address, {files, earlier}, journal, report) do
    Error.map_ok(files, fn file ->
      upload_file(folder, address, {file, earlier[file.name]}, journal, report)
    end)
  end

  defp upload_file(
         _folder,
         _address,
         {%{crc: crc, size: size} = file, %{"crc" => crc, "size" => size} = line},
         _journal,
         report
       ) do
    report.(size)
    {:ok, %{file | etag: line["etag"]}}
  end

  defp upload_file(folder, address, {file, _other}, journal, report) do
    command = %{
      op: "upload",
      bucket: address.bucket,
      key: "#{address.key}/#{file.name}",
      path: Path.join(folder, file.name),
      journal: "#{journal}.#{file.name}",
      part: 8 * 1024 * 1024
    }

    with {:ok, {%{"etag" => etag}, _}} <- Client.request(command, "", report) do
      line = Situ.JSON.encode(%{name: file.name, size: file.size, crc: file.crc, etag: etag})
      _ = File.write(journal <> ".files", [line, "\n"], [:append])
      {:ok, %{file | etag: etag}}
    end
  end

  defp finish_upload(address, manifest, journal, report) do
    command = %{
      op: "put",
      bucket: address.bucket,
      key: Listing.manifest_key(address, manifest.segment?)
    }

    with {:ok, _} <- Client.request(command, Manifest.encode(manifest)) do
      report.()
      _ = File.rm(journal <> ".files")
      {:ok, :copied}
    end
  end
end
