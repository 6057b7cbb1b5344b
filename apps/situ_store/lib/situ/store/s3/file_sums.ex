defmodule Situ.Store.S3.FileSums do
  @moduledoc false
  # The extents of a finished local store with their sizes and the checksums of their blocks.
  alias Situ.Error
  alias Situ.Store.Folder
  alias Situ.Store.S3.{Client, Manifest}

  @typedoc "`crc` is the CRC-32 of all checksums."
  @type t :: %{
          name: String.t(),
          size: non_neg_integer(),
          sums: binary(),
          crc: non_neg_integer()
        }

  @doc "Reads the extents of a store's folder, in order of their names."
  @spec read(Path.t()) :: {:ok, [t()]} | {:error, Error.t()}
  def read(folder) do
    folder
    |> Path.join("{data,large}-*.situ")
    |> Path.wildcard()
    |> Enum.sort()
    |> Error.map_ok(&read_file/1)
  end

  defp read_file(path) do
    command = %{op: "sums", path: path, block: Manifest.block_size()}

    with {:ok, %{size: size}} <- File.stat(path),
         {:ok, {_, sums}} <- Client.request(command) do
      {:ok, %{name: Path.basename(path), size: size, sums: sums, crc: :erlang.crc32(sums)}}
    else
      {:error, reason} when is_atom(reason) -> {:error, Folder.io_error("read #{path}", reason)}
      error -> error
    end
  end
end
