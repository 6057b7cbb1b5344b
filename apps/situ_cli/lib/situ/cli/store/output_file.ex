defmodule Situ.CLI.Store.OutputFile do
  @moduledoc false
  # Writes the output of an export to FILE.unfinished and renames it when it is complete, or writes to standard output.
  alias Situ.Error
  alias Situ.Store.AtomicFile

  @type output :: {Path.t() | :stdout, :file.fd()}

  @doc """
  Calls `write` with the path of a temporary file, and gives the complete file its name. The file is temporary because
  the output may be the recording that is being read.
  """
  @spec write_then_rename!(Path.t(), (Path.t() -> {:ok, result} | {:error, Error.t()})) :: result
        when result: term()
  def write_then_rename!(file, write) do
    unfinished = file <> ".unfinished"

    case write.(unfinished) do
      {:ok, result} ->
        sync_and_rename(unfinished, file)
        result

      {:error, error} ->
        _ = File.rm(unfinished)
        raise error
    end
  end

  @doc "Opens the output for `write_bytes/2`. `-` is standard output, opened as a raw file, which is faster than IO."
  @spec open_output(Path.t()) :: output()
  def open_output("-"), do: {:stdout, open_device!("/dev/stdout", [:append])}
  def open_output(path), do: {path, open_device!(path <> ".unfinished", [:write])}

  defp open_device!(path, modes) do
    case :file.open(path, [:raw, :binary | modes]) do
      {:ok, device} -> device
      {:error, reason} -> raise write_error(path, reason)
    end
  end

  defp write_error(path, reason),
    do: Error.new(:not_saved, "cannot write #{path}", why: to_string(:file.format_error(reason)))

  @doc "Writes bytes to an open output. If that fails, it discards the output and raises."
  @spec write_bytes(output(), iodata()) :: :ok
  def write_bytes({_, device} = out, bytes) do
    case :file.write(device, bytes) do
      :ok ->
        :ok

      {:error, :epipe} ->
        exit(:terminated)

      {:error, reason} ->
        discard_output(out)

        raise Error.new(:not_saved, "the file cannot be written",
                why: to_string(:file.format_error(reason)),
                fix: "free disk space, or write to another location"
              )
    end
  end

  @doc "Closes an output and gives the complete file its name."
  @spec close_output(output()) :: :ok | {:error, term()}
  def close_output({:stdout, device}), do: :file.close(device)

  def close_output({path, device}) do
    with {:error, reason} <- :file.close(device), do: raise(write_error(path, reason))
    sync_and_rename(path <> ".unfinished", path)
  end

  # The file is synced before it is renamed, because the user may delete the original next.
  defp sync_and_rename(unfinished, path) do
    with :ok <- AtomicFile.sync_file(unfinished),
         :ok <- AtomicFile.rename_synced(unfinished, path) do
      :ok
    else
      {:error, reason} -> raise write_error(path, reason)
    end
  end

  @doc "Closes an output and deletes the incomplete file."
  @spec discard_output(output()) :: :ok
  def discard_output({:stdout, _}), do: :ok

  def discard_output({path, device}) do
    _ = :file.close(device)
    _ = File.rm(path <> ".unfinished")
    :ok
  end
end
