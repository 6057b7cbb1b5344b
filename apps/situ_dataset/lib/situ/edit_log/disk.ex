defmodule Situ.EditLog.Disk do
  @moduledoc false
  # The two ways in which the layer changes files: it appends to a log, and it replaces a file. Both return when the
  # change is on disk. A test can stop a program in the middle of either (`put_fault/1`).
  alias Situ.Store.AtomicFile

  @typedoc "The kind of a step, the file, and the bytes that are written."
  @type step :: {:append | :replace, Path.t(), binary()}

  @doc """
  Calls `fun` before each later step of this process; the step is not taken unless it returns `:ok`. Used by tests of
  crashes and full disks.
  """
  @spec put_fault((step() -> :ok | {:error, File.posix()}) | nil) :: :ok
  def put_fault(fun) do
    _ = Process.put(__MODULE__, fun)
    :ok
  end

  defp take_step(step) do
    case Process.get(__MODULE__) do
      nil -> :ok
      fun -> fun.(step)
    end
  end

  @doc "Returns the inode, the size, and the time of the last change in s."
  @spec file_stat(Path.t()) ::
          {:ok, {integer(), non_neg_integer(), integer()}} | {:error, File.posix()}
  def file_stat(path) do
    with {:ok, stat} <- File.stat(path, time: :posix),
         do: {:ok, {stat.inode, stat.size, stat.mtime}}
  end

  @doc """
  Writes `line` to a file from `offset` on and syncs it. An incomplete line of a killed program after `offset` is
  removed first. If the line cannot be written, the file keeps its content up to `offset`.
  """
  @spec append(Path.t(), non_neg_integer(), binary()) :: :ok | {:error, File.posix()}
  def append(path, offset, line) do
    with :ok <- take_step({:append, path, line}),
         {:ok, device} <- :file.open(path, [:read, :write, :raw, :binary]) do
      result = write_at(device, offset, line)
      _ = :file.close(device)
      result
    end
  end

  defp write_at(device, offset, line) do
    with {:ok, size} <- :file.position(device, :eof),
         :ok <- if(size > offset, do: truncate_at(device, offset), else: :ok),
         :ok <- :file.pwrite(device, offset, line),
         :ok <- :file.datasync(device) do
      :ok
    else
      {:error, reason} ->
        _ = truncate_at(device, offset)
        {:error, reason}
    end
  end

  defp truncate_at(device, offset) do
    with {:ok, ^offset} <- :file.position(device, offset), do: :file.truncate(device)
  end

  @doc "Replaces a file atomically."
  @spec replace(Path.t(), binary()) :: :ok | {:error, File.posix()}
  def replace(path, content) do
    with :ok <- take_step({:replace, path, content}), do: AtomicFile.write(path, content)
  end
end
