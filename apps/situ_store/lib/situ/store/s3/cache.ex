defmodule Situ.Store.S3.Cache do
  @moduledoc false
  # The folder of mirrors of remote recordings, which all programs of a user share. A mirror is in `objects/HASH`. The
  # hash includes the version of the remote manifest, so its contents never become outdated. `sets/HASH/NAME` are links
  # to the current mirrors of a remote folder.
  # See docs/adr/0194-recordings-in-object-storage-are-read-through-mirrors.md.

  @default_bytes 10 * 1024 * 1024 * 1024

  @doc """
  Returns the cache's folder: `SITU_S3_CACHE`, or `situ/s3` in the user's cache folder (`XDG_CACHE_HOME`).
  """
  @spec root() :: Path.t()
  def root do
    Path.expand(
      System.get_env("SITU_S3_CACHE") ||
        Path.join(System.get_env("XDG_CACHE_HOME") || Path.expand("~/.cache"), "situ/s3")
    )
  end

  @doc "Returns the limit of fetched bytes: `SITU_S3_CACHE_BYTES`, or 10 GiB."
  @spec max_bytes() :: non_neg_integer()
  def max_bytes do
    case Integer.parse(System.get_env("SITU_S3_CACHE_BYTES") || "") do
      {bytes, ""} when bytes >= 0 -> bytes
      _ -> @default_bytes
    end
  end

  @doc "Returns whether a path is in the cache."
  @spec contains?(Path.t()) :: boolean()
  def contains?(path), do: String.starts_with?(path, root() <> "/")

  @doc "Returns the folder of mirrors whose parts are these."
  @spec object_folder([String.t() | nil]) :: Path.t()
  def object_folder(parts), do: Path.join([root(), "objects", hash_parts(parts)])

  @doc "Returns the folder with links to the mirrors of a remote folder."
  @spec set_folder([String.t()]) :: Path.t()
  def set_folder(parts), do: Path.join([root(), "sets", hash_parts(parts)])

  @doc "Returns the journal of an upload."
  @spec journal_path([String.t()]) :: Path.t()
  def journal_path(parts), do: Path.join([root(), "uploads", hash_parts(parts)])

  @doc "Returns the file with the facts about a remote recording."
  @spec facts_path([String.t() | nil]) :: Path.t()
  def facts_path(parts), do: Path.join([root(), "facts", hash_parts(parts)])

  defp hash_parts(parts) do
    bytes = Enum.map(parts, &[<<byte_size(&1 || "")::32>>, &1 || ""])
    :sha256 |> :crypto.hash(bytes) |> binary_part(0, 16) |> Base.encode16(case: :lower)
  end

  @doc "Creates a folder of the cache, which only its user may read."
  @spec make_folder(Path.t()) :: :ok | {:error, File.posix()}
  def make_folder(path) do
    with :ok <- File.mkdir_p(root()),
         :ok <- File.chmod(root(), 0o700),
         do: File.mkdir_p(path)
  end
end
