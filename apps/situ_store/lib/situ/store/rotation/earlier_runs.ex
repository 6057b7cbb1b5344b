defmodule Situ.Store.Rotation.EarlierRuns do
  @moduledoc false
  # Finds the segments that earlier runs of the same recorder left in its folder. Segments are marked in their catalogs.
  # Other recordings of that name are neither counted nor deleted.
  alias Situ.Store.{Folder, Query}

  # A clock that shows a time before 2020 had not been set.
  @first_set 1_577_836_800_000_000_000

  @type piece :: %{
          path: Path.t(),
          order: {:earlier, non_neg_integer()},
          size: non_neg_integer(),
          duration: non_neg_integer() | nil,
          ended: integer() | nil
        }

  @doc """
  Returns the segments of `name` in `root`, oldest first. `ended` is a time of the monotonic clock, which reads `now`
  when the wall clock reads `wall`. It is `nil` if the wall clock had not been set or has been set back since.
  """
  @spec list_segments(String.t(), Path.t(), integer(), Situ.Time.t()) :: [piece()]
  def list_segments(name, root, now, wall) do
    found =
      for path <- Folder.list_versions(name, root),
          {:ok, store} <- [Query.open(path)],
          %{piece: %{} = piece} = info <- [Query.info(store)] do
        {path, store, piece, info}
      end

    found = order_segments(found)
    ends = found |> Enum.drop(1) |> Enum.map(fn {_, _, _, info} -> info.created end)

    for {{{path, store, piece, _info}, ended}, n} <-
          Enum.with_index(Enum.zip(found, ends ++ [wall])) do
      %{
        path: path,
        order: {:earlier, n},
        size: Folder.total_size(path),
        duration: segment_duration(piece, store),
        ended: if(ended in @first_set..wall, do: now - (wall - ended))
      }
    end
  end

  # If a stream was ahead of the others, its segment was created before theirs. Segments of earlier releases have no
  # number, and are ordered by their creation.
  defp order_segments(found) do
    found
    |> Enum.chunk_by(fn {_, _, piece, _} -> piece.run end)
    |> Enum.flat_map(&Enum.sort_by(&1, fn {_, _, piece, _} -> piece.number end))
  end

  # The last segment of a run is incomplete, so its duration is the time span of its messages.
  defp segment_duration(%{full?: true, every: every}, _store) when is_integer(every), do: every

  defp segment_duration(%{every: every}, store) when is_integer(every) do
    case Query.interval(store) do
      nil -> 0
      {first, last} -> min(last - first, every)
    end
  end

  defp segment_duration(_by_size, _store), do: nil
end
