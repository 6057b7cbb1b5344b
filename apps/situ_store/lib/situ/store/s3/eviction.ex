defmodule Situ.Store.S3.Eviction do
  @moduledoc false
  # Limits the size of the cache.
  alias Situ.Store.S3.{Cache, MirrorFile}

  @doc """
  Empties extents if the mirrors contain more than the limit, beginning with the least recently used mirror. A reader
  keeps the files that it has open, and fetches their bytes again when it needs others.
  """
  @spec limit_size(non_neg_integer()) :: :ok
  def limit_size(limit \\ Cache.max_bytes()) do
    extents =
      for mirror <- Path.wildcard(Path.join(Cache.root(), "objects/*")),
          used = last_use(mirror),
          path <- Path.wildcard(Path.join(mirror, "*.mirror")),
          bytes = MirrorFile.fetched_bytes(path),
          bytes > 0,
          do: {used, path, bytes}

    total = extents |> Enum.map(&elem(&1, 2)) |> Enum.sum()
    empty_extents(Enum.sort(extents), total, limit)
  end

  defp empty_extents([{_, path, bytes} | rest], total, limit) when total > limit do
    MirrorFile.empty(path)
    empty_extents(rest, total - bytes, limit)
  end

  defp empty_extents(_extents, _total, _limit), do: :ok

  defp last_use(mirror) do
    case File.stat(Path.join(mirror, "mirror.json"), time: :posix) do
      {:ok, %{mtime: time}} -> time
      {:error, _} -> 0
    end
  end
end
