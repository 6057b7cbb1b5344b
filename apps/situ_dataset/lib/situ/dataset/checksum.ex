defmodule Situ.Dataset.Checksum do
  @moduledoc false
  # Computes a checksum over all bytes of a recording, as `Situ.Dataset.seal/2` describes it.
  alias Situ.Dataset.StoreVersion
  alias Situ.Error

  @chunk 1_048_576

  @doc "Computes the checksum of a file or a folder. Error: `:io`, which names the file."
  @spec compute(Path.t()) :: {:ok, String.t()} | {:error, Error.t()}
  def compute(path) do
    with {:ok, files} <- list_files(path),
         {:ok, lines} <- file_lines(files, path) do
      {:ok, "sha256:" <> encode_hex(:crypto.hash(:sha256, lines))}
    end
  end

  @doc """
  Computes the checksums of the partitions' recordings and returns `{:ok, checksums_by_path}`. Option: `progress:`,
  which is called as `fun.(done, total)`.
  """
  @spec compute_all([Situ.Dataset.Partition.t()], keyword()) ::
          {:ok, %{Path.t() => String.t()}} | {:error, Error.t()}
  def compute_all(partitions, opts \\ []) do
    progress = opts[:progress] || fn _, _ -> :ok end
    total = length(partitions)

    partitions
    |> Enum.with_index(1)
    |> Enum.reduce_while({:ok, %{}}, fn {%{path: path}, n}, {:ok, done} ->
      case compute(path) do
        {:ok, checksum} ->
          progress.(n, total)
          {:cont, {:ok, Map.put(done, path, checksum)}}

        error ->
          {:halt, error}
      end
    end)
  end

  @doc "Returns `:ok` if the recording still has that checksum. Error: `:changed`."
  @spec verify(Path.t(), String.t()) :: :ok | {:error, Error.t()}
  def verify(path, checksum) do
    case compute(path) do
      {:ok, ^checksum} ->
        :ok

      {:ok, now} ->
        {:error,
         Error.new(:changed, "#{path} has changed since the dataset was sealed",
           why: "its checksum is #{now}, but the dataset contains #{checksum}",
           fix: "restore the recording, or seal the dataset again if the change was intended"
         )}

      error ->
        error
    end
  end

  # A path without a version means the newest version.
  defp list_files(path) do
    path = if File.exists?(path), do: path, else: StoreVersion.newest_folder(path) || path

    cond do
      File.regular?(path) -> {:ok, [path]}
      File.dir?(path) -> {:ok, path |> Path.join("*") |> Path.wildcard() |> Enum.sort()}
      true -> list_segment_files(path)
    end
  end

  defp list_segment_files(path) do
    with {:ok, store} <- Situ.Store.open(path),
         [_ | _] = segments <- Situ.Store.segments(store) do
      {:ok,
       Enum.flat_map(segments, &(&1.path |> Path.join("*") |> Path.wildcard() |> Enum.sort()))}
    else
      _ -> {:error, read_error(path, :enoent)}
    end
  end

  defp file_name(root, root), do: ""

  defp file_name(file, root) do
    if Path.dirname(file) == root,
      do: Path.basename(file),
      else: Path.relative_to(file, Path.dirname(root))
  end

  defp file_lines(files, root) do
    files
    |> Enum.filter(&(File.regular?(&1) and Path.extname(&1) != ".lock"))
    |> Enum.reduce_while({:ok, []}, fn file, {:ok, lines} ->
      case file_digest(file) do
        {:ok, size, digest} ->
          name = file_name(file, root)
          {:cont, {:ok, [lines, name, 0, Integer.to_string(size), 0, digest]}}

        {:error, reason} ->
          {:halt, {:error, read_error(file, reason)}}
      end
    end)
  end

  defp file_digest(file) do
    with {:ok, device} <- :file.open(file, [:read, :raw, :binary]) do
      result = hash_chunks(device, :crypto.hash_init(:sha256), 0)
      _ = :file.close(device)
      result
    end
  end

  defp hash_chunks(device, hash, size) do
    case :file.read(device, @chunk) do
      {:ok, bytes} ->
        hash_chunks(device, :crypto.hash_update(hash, bytes), size + byte_size(bytes))

      :eof ->
        {:ok, size, :crypto.hash_final(hash)}

      {:error, reason} ->
        {:error, reason}
    end
  end

  defp encode_hex(bytes), do: Base.encode16(bytes, case: :lower)

  defp read_error(path, reason) do
    Error.new(:io, "cannot read #{path}",
      why: to_string(:file.format_error(reason)),
      fix: "check that the recording exists and is readable"
    )
  end
end
