defmodule Situ.Dataset.LayersPartition do
  @moduledoc false
  # Recognizes and builds the partition of a session's annotation layers. Its path has no version, so that it is always
  # the newest version of its store.
  alias Situ.Dataset.Partition

  @name "Annotations"
  @store "annotations"

  @doc "Returns the path of the store in a session's folder."
  @spec store_path(Path.t()) :: Path.t()
  def store_path(folder), do: Path.join(folder, @store)

  @doc "Returns whether a path, without a version, is that of such a store."
  @spec layers_path?(Path.t()) :: boolean()
  def layers_path?(path), do: Path.basename(path) == @store

  @doc """
  Returns the path of such a store without its version; other paths are returned unchanged.

      iex> for path <- ~w(p1/annotations.0002 p1/room.0002),
      ...>   do: Situ.Dataset.LayersPartition.drop_version(path)
      ["p1/annotations", "p1/room.0002"]
  """
  @spec drop_version(Path.t()) :: Path.t()
  def drop_version(path) do
    bare = Path.rootname(path)
    if layers_path?(bare) and path =~ ~r/\.\d{4,}\z/, do: bare, else: path
  end

  @doc "Builds the partition of the store at a path."
  @spec build_partition(Path.t()) :: Partition.t()
  def build_partition(path), do: %Partition{name: @name, store: @store, path: path}
end
