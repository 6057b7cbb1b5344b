defmodule Situ.Experiment.FileTransfer do
  @moduledoc false
  # Copies files between the nodes of a cluster, over the connection of the nodes. The receiver asks for one part after
  # another, so a copy uses little memory and does not delay other messages of the nodes for long.
  alias Situ.Error

  @part 1_048_576
  @wait_ms 120_000

  @typedoc "The path below a root, the size in bytes, and the time of the last change in seconds since 1970."
  @type entry :: {relative :: String.t(), size :: non_neg_integer(), changed :: integer()}

  @doc "Lists all files below a folder, sorted."
  @spec list_files(Path.t()) :: [entry()]
  def list_files(root), do: root |> list_below("") |> Enum.sort()

  @doc """
  Lists the files of a recording, relative to its parent folder: a folder, the segments of a name, or a file with the
  files that have the same name up to the first dot. A recording that does not exist has none.
  """
  @spec list_recording(Path.t()) :: [entry()]
  def list_recording(path) do
    root = Path.dirname(path)
    base = Path.basename(path)

    names =
      cond do
        File.dir?(path) -> [base]
        File.regular?(path) -> list_names(root, &(first_word(&1) == first_word(base)))
        true -> list_names(root, &(&1 =~ ~r/\A#{Regex.escape(base)}\.\d{4,}\z/))
      end

    names |> Enum.flat_map(&list_entry(root, &1)) |> Enum.sort()
  end

  defp list_names(folder, fits?) do
    case File.ls(folder) do
      {:ok, names} -> Enum.filter(names, fits?)
      {:error, _} -> []
    end
  end

  defp first_word(name), do: name |> String.split(".", parts: 2) |> hd()

  defp list_below(root, relative) do
    names = list_names(Path.join(root, relative), fn _ -> true end)
    Enum.flat_map(names, &list_entry(root, Path.join(relative, &1)))
  end

  defp list_entry(root, relative) do
    case File.stat(Path.join(root, relative), time: :posix) do
      {:ok, %{type: :directory}} -> list_below(root, relative)
      {:ok, %{type: :regular, size: size, mtime: time}} -> [{relative, size, time}]
      _ -> []
    end
  end

  @doc "Copies the files of `entries` from the folder `source` of another node. Error: `:not_copied`."
  @spec fetch_files(node(), Path.t(), [entry()], Path.t()) :: :ok | {:error, Error.t()}
  def fetch_files(node, source, entries, target) do
    Enum.reduce_while(entries, :ok, fn {relative, _, _}, :ok ->
      case fetch_file(node, Path.join(source, relative), Path.join(target, relative)) do
        :ok -> {:cont, :ok}
        {:error, reason} -> {:halt, {:error, copy_error(node, relative, reason)}}
      end
    end)
  end

  @doc "Copies a folder of another node. Error: `:not_copied`."
  @spec fetch_folder(node(), Path.t(), Path.t()) :: :ok | {:error, Error.t()}
  def fetch_folder(node, source, target) do
    with {:ok, entries} <- call_node(node, :list_files, [source]) do
      fetch_files(node, source, entries, target)
    else
      {:error, reason} -> {:error, copy_error(node, source, reason)}
    end
  end

  defp fetch_file(node, from, to) do
    with :ok <- File.mkdir_p(Path.dirname(to)),
         {:ok, device} <- :file.open(to, [:write, :raw, :binary]) do
      result = fetch_parts(node, from, device, 0)
      _ = :file.close(device)
      result
    end
  end

  defp fetch_parts(node, from, device, offset) do
    with {:ok, {:ok, bytes}} <- call_node(node, :read_part, [from, offset]),
         :ok <- :file.write(device, bytes) do
      fetch_parts(node, from, device, offset + byte_size(bytes))
    else
      {:ok, :eof} -> :ok
      {:ok, {:error, reason}} -> {:error, reason}
      {:error, reason} -> {:error, reason}
    end
  end

  @doc "Reads the part of a file that begins at an offset."
  @spec read_part(Path.t(), non_neg_integer()) :: {:ok, binary()} | :eof | {:error, :file.posix()}
  def read_part(path, offset) do
    with {:ok, device} <- :file.open(path, [:read, :raw, :binary]) do
      result = :file.pread(device, offset, @part)
      _ = :file.close(device)
      result
    end
  end

  defp call_node(node, function, arguments) do
    {:ok, :erpc.call(node, __MODULE__, function, arguments, @wait_ms)}
  catch
    _, reason -> {:error, reason}
  end

  defp copy_error(node, name, reason) do
    Error.new(:not_copied, "cannot copy #{name} from #{node}",
      why: describe_reason(reason),
      fix: "check the disk space of both machines, and their connection"
    )
  end

  defp describe_reason(reason) when is_atom(reason),
    do: to_string(:file.format_error(reason))

  defp describe_reason(reason), do: inspect(reason, limit: 5)
end
