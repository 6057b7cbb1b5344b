defmodule Situ.Cluster.Log.Folder do
  @moduledoc false
  # Keeps the log of one machine in a folder, without a server. Any number of OS processes may
  # write to it, and each may be killed at any time.
  #
  # An entry is a file named by its number. The file is written under a temporary name and then
  # hard-linked to its final name. The link fails if that name exists, so the file system itself
  # provides the compare-and-set. A linked entry survives a kill of the process and, with `sync:
  # true`, also a power failure.
  #
  #     root/streams/<subject>/<thousand>/<number>
  #     root/keys/<subject>/<number>                 the last two entries
  #     root/tmp/                                    entries being written
  #
  # A subject whose name is too long for a file name has the folder `h-SHA256`, with the name in
  # its file `name`.
  #
  # Network file systems do not support this reliably. Use NATS for several machines.
  #
  # Options:
  #
  #   * `:sync` (a boolean, default `false`) - wait until each entry was written to the disk.
  @behaviour Situ.Cluster.Log

  alias Situ.{Error, Options}
  alias Situ.Cluster.Log.Entry

  @schema [sync: [type: :boolean, default: false]]
  @bucket 1_000
  # Larger entries would work, but each entry is read and written as a whole.
  @limit 64 * 1024 * 1024

  @enforce_keys [:root, :sync]
  defstruct [:root, :sync]

  @type t :: %__MODULE__{root: Path.t(), sync: boolean()}

  @impl true
  def connect(root, opts) do
    root = Path.expand(root)

    with {:ok, opts} <- Options.validate(opts, @schema),
         :ok <- check_created(File.mkdir_p(Path.join(root, "tmp")), root),
         :ok <- check_created(File.chmod(root, 0o700), root),
         do: {:ok, %__MODULE__{root: root, sync: opts[:sync]}}
  end

  defp check_created(:ok, _root), do: :ok

  defp check_created({:error, reason}, root) do
    {:error,
     Error.new(:no_log, "cannot create a log in #{inspect(root)}: #{:file.format_error(reason)}",
       fix: "choose a folder that you can write to"
     )}
  end

  @impl true
  def append(%__MODULE__{} = log, subject, expected, %Entry{} = entry) do
    target = entry_path(log, subject, expected + 1)
    tmp = Path.join([log.root, "tmp", unique_name()])

    with :ok <- write_file(log, tmp, Entry.encode(entry)),
         result <- link_entry(tmp, target, subject),
         _ <- File.rm(tmp) do
      case result do
        :ok -> confirm_link(log, subject, expected, target)
        {:error, :eexist} -> resolve_conflict(log, subject, expected + 1, entry)
        {:error, reason} -> {:error, file_error(target, reason)}
      end
    end
  end

  # The name may be free because its entry was deleted long ago. In that case the previous entry was deleted, too.
  defp confirm_link(log, subject, expected, target) do
    if expected == 0 or File.exists?(entry_path(log, subject, expected)) do
      if expected == 0 and latest_numbers(log, subject) != [1],
        do: take_back(log, subject, target),
        else: finish_append(log, subject, expected + 1)
    else
      take_back(log, subject, target)
    end
  end

  defp take_back(log, subject, target) do
    File.rm(target)
    with {:ok, last} <- last(log, subject), do: {:refused, last}
  end

  defp finish_append(log, {:key, _} = subject, seq) do
    if seq > 2, do: File.rm(entry_path(log, subject, seq - 2))
    {:ok, seq}
  end

  defp finish_append(_log, _subject, seq), do: {:ok, seq}

  defp resolve_conflict(log, subject, seq, entry) do
    case fetch_entry(log, subject, seq) do
      {:ok, %Entry{op: op}} when op == entry.op -> {:ok, seq}
      {:error, error} -> {:error, error}
      _ -> with {:ok, last} <- last(log, subject), do: {:refused, last}
    end
  end

  @impl true
  def last(%__MODULE__{} = log, subject) do
    case latest_numbers(log, subject) do
      [] ->
        {:ok, nil}

      seqs ->
        # The entry may be deleted after it was listed. In that case a later entry exists.
        with {:ok, nil} <- fetch_entry(log, subject, Enum.max(seqs)), do: last(log, subject)
    end
  end

  @impl true
  def read(%__MODULE__{} = log, subject, from, max) do
    case fetch_entry(log, subject, from) do
      {:ok, %Entry{} = entry} ->
        if max == 1,
          do: {:ok, [entry]},
          else: read_following(log, subject, from + 1, max - 1, [entry])

      {:ok, nil} ->
        read_from_first(log, subject, from, max)

      error ->
        error
    end
  end

  defp read_following(_log, _subject, _seq, 0, entries), do: {:ok, Enum.reverse(entries)}

  defp read_following(log, subject, seq, max, entries) do
    case fetch_entry(log, subject, seq) do
      {:ok, %Entry{} = entry} ->
        read_following(log, subject, seq + 1, max - 1, [entry | entries])

      {:ok, nil} ->
        {:ok, Enum.reverse(entries)}

      error ->
        error
    end
  end

  # The first entries may have been trimmed.
  defp read_from_first(log, subject, from, max) do
    case first_number(log, subject) do
      first when is_integer(first) and first > from -> read(log, subject, first, max)
      _ -> {:ok, []}
    end
  end

  @impl true
  def first(%__MODULE__{} = log, subject, from) do
    with {:ok, entries} <- read(log, subject, from, 1), do: {:ok, List.first(entries)}
  end

  @impl true
  def trim(%__MODULE__{} = log, subject, seq) do
    first = first_number(log, subject)
    last = Enum.max(latest_numbers(log, subject), fn -> 0 end)
    # Entries are deleted in order: if an entry does not exist, no earlier one does.
    if first,
      do: for(n <- first..(min(seq, last) - 1)//1, do: File.rm(entry_path(log, subject, n)))

    :ok
  end

  @impl true
  def subjects(%__MODULE__{} = log) do
    subjects =
      for {kind, folder} <- [stream: "streams", key: "keys"],
          folder = Path.join(log.root, folder),
          name <- list_folder(folder),
          subject = decode_subject(folder, name),
          do: describe_subject(log, {kind, subject})

    {:ok, subjects}
  end

  defp decode_subject(_folder, "s-" <> name), do: URI.decode(name)

  defp decode_subject(folder, "h-" <> _ = name) do
    case File.read(Path.join([folder, name, "name"])) do
      {:ok, subject} -> subject
      {:error, _} -> nil
    end
  end

  defp decode_subject(_folder, _name), do: nil

  defp list_folder(folder) do
    case File.ls(folder) do
      {:ok, names} -> names
      {:error, _} -> []
    end
  end

  # Only the last entry of a key counts.
  defp describe_subject(log, {kind, _} = subject) do
    files =
      if kind == :key,
        do: subject |> newest_file(log) |> List.wrap(),
        else: list_files(log, subject)

    stats = for file <- files, {:ok, stat} <- [File.stat(file, time: :posix)], do: stat

    %{
      subject: subject,
      entries: length(stats),
      bytes: stats |> Enum.map(& &1.size) |> Enum.sum(),
      written: stats |> Enum.map(&(&1.mtime * 1_000_000_000)) |> Enum.max(fn -> nil end)
    }
  end

  defp newest_file(subject, log) do
    with [_ | _] = seqs <- latest_numbers(log, subject),
         do: entry_path(log, subject, Enum.max(seqs))
  end

  defp list_files(log, subject) do
    folder = subject_folder(log, subject)
    buckets = for n <- list_numbers(folder), do: Path.join(folder, Integer.to_string(n))
    for bucket <- buckets, n <- list_numbers(bucket), do: Path.join(bucket, Integer.to_string(n))
  end

  @impl true
  def delete(%__MODULE__{} = log, subject) do
    case File.rm_rf(subject_folder(log, subject)) do
      {:ok, _} -> :ok
      {:error, reason, path} -> {:error, file_error(path, reason)}
    end
  end

  @impl true
  def limit(_log), do: @limit

  @impl true
  def close(_log), do: :ok

  # The following functions handle files.

  defp fetch_entry(log, subject, seq) do
    path = entry_path(log, subject, seq)

    case :file.open(path, [:read, :raw, :binary]) do
      {:ok, io} ->
        bytes = read_all(io, [])
        :file.close(io)

        case Entry.decode(bytes, seq) do
          {:ok, entry} -> {:ok, entry}
          {:error, why} -> {:error, Error.new(:damaged, "cannot read #{path}: #{why}")}
        end

      {:error, reason} when reason in [:enoent, :enotdir] ->
        {:ok, nil}

      {:error, reason} ->
        {:error, file_error(path, reason)}
    end
  end

  defp read_all(io, acc) do
    case :file.read(io, 262_144) do
      {:ok, bytes} when byte_size(bytes) == 262_144 -> read_all(io, [acc, bytes])
      {:ok, bytes} -> IO.iodata_to_binary([acc, bytes])
      _ -> IO.iodata_to_binary(acc)
    end
  end

  defp write_file(log, path, bytes) do
    with {:ok, io} <- :file.open(path, [:write, :raw, :binary, :exclusive]),
         :ok <- :file.write(io, bytes),
         :ok <- if(log.sync, do: :file.datasync(io), else: :ok),
         :ok <- :file.close(io) do
      :ok
    else
      {:error, reason} ->
        File.rm(path)
        {:error, file_error(path, reason)}
    end
  end

  defp link_entry(tmp, target, subject) do
    with {:error, :enoent} <- :file.make_link(tmp, target),
         :ok <- File.mkdir_p(Path.dirname(target)),
         :ok <- write_name_file(subject, target),
         do: :file.make_link(tmp, target)
  end

  # A folder named by a hash stores the name of its subject in a file.
  defp write_name_file({kind, subject}, target) do
    levels = if kind == :key, do: 1, else: 2
    folder = Enum.reduce(1..levels, target, fn _, path -> Path.dirname(path) end)

    if String.starts_with?(Path.basename(folder), "h-"),
      do: File.write(Path.join(folder, "name"), subject),
      else: :ok
  end

  defp file_error(path, reason) do
    Error.new(:log_failed, "#{path}: #{:file.format_error(reason)}",
      why: "the log is a folder that all processes of this machine write to",
      fix: "free disk space, or give the processes write permission"
    )
  end

  defp latest_numbers(log, {:key, _} = subject), do: list_numbers(subject_folder(log, subject))

  # Lists only the newest nonempty bucket, which contains the last entry.
  defp latest_numbers(log, subject) do
    folder = subject_folder(log, subject)

    folder
    |> list_numbers()
    |> Enum.sort(:desc)
    |> Enum.find_value([], fn bucket ->
      with [] <- list_numbers(Path.join(folder, Integer.to_string(bucket))), do: nil
    end)
  end

  defp first_number(log, {:key, _} = subject),
    do: Enum.min(latest_numbers(log, subject), fn -> nil end)

  defp first_number(log, subject) do
    folder = subject_folder(log, subject)

    folder
    |> list_numbers()
    |> Enum.sort()
    |> Enum.find_value(fn bucket ->
      folder |> Path.join(Integer.to_string(bucket)) |> list_numbers() |> Enum.min(fn -> nil end)
    end)
  end

  defp list_numbers(folder) do
    case File.ls(folder) do
      {:ok, names} -> for name <- names, {number, ""} <- [Integer.parse(name)], do: number
      {:error, _} -> []
    end
  end

  defp entry_path(log, {:key, _} = subject, seq),
    do: Path.join(subject_folder(log, subject), Integer.to_string(seq))

  defp entry_path(log, subject, seq) do
    bucket = Integer.to_string(div(seq, @bucket))
    Path.join([subject_folder(log, subject), bucket, Integer.to_string(seq)])
  end

  defp subject_folder(log, {:stream, subject}),
    do: Path.join([log.root, "streams", folder_name(subject)])

  defp subject_folder(log, {:key, subject}),
    do: Path.join([log.root, "keys", folder_name(subject)])

  # Subjects are escaped so that they cannot act as paths, and file names are limited to 255 bytes.
  defp folder_name(subject) do
    case URI.encode(subject, &(URI.char_unreserved?(&1) and &1 != ?~)) do
      name when byte_size(name) <= 240 -> "s-" <> name
      _ -> "h-" <> Base.encode16(:crypto.hash(:sha256, subject), case: :lower)
    end
  end

  defp unique_name, do: Base.encode16(:crypto.strong_rand_bytes(8), case: :lower)
end
