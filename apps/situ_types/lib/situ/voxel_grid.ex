defmodule Situ.VoxelGrid do
  @moduledoc """
  A sparse grid of values in cubes of space. The cube of a point has the indices `floor(coordinate / size)`.

      iex> grid = Situ.VoxelGrid.new(0.5) |> Situ.VoxelGrid.update_at({0.6, -0.1, 0.0}, 1, &(&1 + 1))
      iex> Situ.VoxelGrid.fetch_at(grid, {0.9, -0.4, 0.2})
      {:ok, 1}
  """
  alias Situ.Vector3

  @enforce_keys [:size]
  defstruct [:size, voxels: %{}]

  @type index :: {integer(), integer(), integer()}
  @type t :: t(term())
  @type t(value) :: %__MODULE__{size: float(), voxels: %{index() => value}}

  @doc "Builds an empty grid of cubes with edges of `size` metres."
  @spec new(number()) :: t()
  def new(size) when is_number(size) and size > 0, do: %__MODULE__{size: size * 1.0}

  @doc "Returns the indices of the cube that contains a point."
  @spec voxel_index(t(), Vector3.t()) :: index()
  def voxel_index(%__MODULE__{size: size}, {x, y, z}),
    do: {floor(x / size), floor(y / size), floor(z / size)}

  @doc "Returns the center of a cube."
  @spec voxel_center(t(), index()) :: Vector3.t()
  def voxel_center(%__MODULE__{size: size}, {i, j, k}),
    do: {(i + 0.5) * size, (j + 0.5) * size, (k + 0.5) * size}

  @doc "Puts a value into the cube that contains a point."
  @spec put_at(t(), Vector3.t(), term()) :: t()
  def put_at(%__MODULE__{} = grid, point, value),
    do: %{grid | voxels: Map.put(grid.voxels, voxel_index(grid, point), value)}

  @doc "Applies `fun` to the value in the cube that contains a point, or puts `initial` if the cube is empty."
  @spec update_at(t(), Vector3.t(), term(), (term() -> term())) :: t()
  def update_at(%__MODULE__{} = grid, point, initial, fun),
    do: %{grid | voxels: Map.update(grid.voxels, voxel_index(grid, point), initial, fun)}

  @doc "Returns the value in the cube that contains a point."
  @spec fetch_at(t(), Vector3.t()) :: {:ok, term()} | :error
  def fetch_at(%__MODULE__{} = grid, point), do: Map.fetch(grid.voxels, voxel_index(grid, point))

  @doc "Removes the cubes for which `fun.(center, value)` is true."
  @spec reject_voxels(t(), (Vector3.t(), term() -> boolean())) :: t()
  def reject_voxels(%__MODULE__{} = grid, fun) do
    kept =
      for {index, value} <- grid.voxels,
          not fun.(voxel_center(grid, index), value),
          into: %{},
          do: {index, value}

    %{grid | voxels: kept}
  end

  @doc "Returns the number of cubes that hold a value."
  @spec voxel_count(t()) :: non_neg_integer()
  def voxel_count(%__MODULE__{voxels: voxels}), do: map_size(voxels)

  defimpl Inspect do
    def inspect(grid, _opts),
      do: "#Situ.VoxelGrid<#{Kernel.inspect(grid.size)} m, #{map_size(grid.voxels)} voxels>"
  end
end
