defmodule Situ.Bridge.Columnar.Output do
  @moduledoc false
  # A file that is written under a temporary name until it is complete.
  alias Situ.Error

  @enforce_keys [:path, :file]
  defstruct [:path, :file, at: 0]
  @type t :: %__MODULE__{path: Path.t(), file: :file.fd(), at: non_neg_integer()}

  @spec create_file(Path.t(), iodata()) :: {:ok, t()} | {:error, Error.t()}
  def create_file(path, head) do
    case :file.open(unfinished_path(path), [:write, :raw, :binary]) do
      {:ok, file} -> append_bytes(%__MODULE__{path: path, file: file}, head)
      {:error, reason} -> {:error, write_error(path, reason)}
    end
  end

  defp unfinished_path(path), do: path <> ".unfinished"

  @doc "Appends bytes and advances `at`, the offset at which the file ends."
  @spec append_bytes(t(), iodata()) :: {:ok, t()} | {:error, Error.t()}
  def append_bytes(output, bytes) do
    case :file.write(output.file, bytes) do
      :ok -> {:ok, %{output | at: output.at + IO.iodata_length(bytes)}}
      {:error, reason} -> {:error, write_error(output.path, reason)}
    end
  end

  @doc "Writes the tail, closes the file and renames it to its final name."
  @spec finish_file(t(), iodata()) :: :ok | {:error, Error.t()}
  def finish_file(output, tail) do
    with :ok <- :file.write(output.file, tail),
         :ok <- :file.close(output.file),
         :ok <- :file.rename(unfinished_path(output.path), output.path) do
      :ok
    else
      {:error, reason} -> {:error, write_error(output.path, reason)}
    end
  end

  @doc "Closes and deletes the unfinished file."
  @spec delete_unfinished(t()) :: :ok
  def delete_unfinished(output) do
    :file.close(output.file)
    :file.delete(unfinished_path(output.path))
    :ok
  end

  defp write_error(path, :enospc),
    do: Error.new(:disk_full, "no space left on the disk of #{path}")

  defp write_error(path, reason),
    do: Error.new(:io, "cannot write #{path}", why: to_string(:file.format_error(reason)))
end
