defmodule Situ.Space.GeometryFile do
  @moduledoc false
  # Opens files of points and surfaces as recordings of one message. `Situ.Space` lists the extensions, their content
  # and their streams.
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format

  alias Situ.{Error, Mesh, Message, PointCloud}
  alias Situ.Space.GeometryFile.{Collada, Gltf, Las, Obj, Pcd, Ply, Stl}
  alias Situ.Space.FileParser
  alias Situ.Store.StreamInfo

  @enforce_keys [:path, :data, :origin]
  defstruct [:path, :data, :origin]

  @type t :: %__MODULE__{
          path: Path.t(),
          data: PointCloud.t() | Mesh.t(),
          origin: Situ.Vector3.t()
        }

  @most 2_000_000_000

  @doc """
  Reads the points or the surface of a file. With `axes: :own` the axes of a Collada file are not converted to z up,
  because robot files use its coordinates unchanged.
  """
  @spec read(Path.t(), keyword()) :: {:ok, PointCloud.t() | Mesh.t()} | {:error, Error.t()}
  def read(path, opts \\ []), do: with({:ok, scan} <- open(path, opts), do: {:ok, scan.data})

  @impl true
  def extensions, do: Enum.flat_map(kinds(), & &1.extensions)

  # Parsers are chosen by extension, so there are no signatures.
  @impl true
  def kinds do
    for {name, title, extensions} <- [
          {:collada, "Collada scene", [".dae"]},
          {:gltf, "glTF scene", [".glb", ".gltf"]},
          {:las, "LAS and LAZ point cloud", [".las", ".laz"]},
          {:obj, "Wavefront OBJ mesh", [".obj"]},
          {:pcd, "PCD point cloud", [".pcd"]},
          {:ply, "PLY point cloud or mesh", [".ply"]},
          {:stl, "STL mesh", [".stl"]}
        ] do
      %Situ.Recording.FileKind{
        name: name,
        title: title,
        extensions: extensions,
        open: __MODULE__
      }
    end
  end

  @impl true
  def open(path, opts) do
    parse = &parse_scan(String.downcase(Path.extname(path)), &1, {Path.dirname(path), opts})

    with {:ok, data, origin} <- FileParser.read_and_parse(path, @most, parse),
         do: {:ok, %__MODULE__{path: path, data: data, origin: origin}}
  end

  defp parse_scan(las, bytes, _asked) when las in [".las", ".laz"], do: Las.parse_file(bytes)

  defp parse_scan(ending, bytes, asked) do
    with {:ok, data} <- parse_shape(ending, bytes, asked), do: {:ok, data, {0.0, 0.0, 0.0}}
  end

  defp parse_shape(".dae", bytes, {_folder, opts}), do: Collada.parse_file(bytes, opts)

  defp parse_shape(gltf, bytes, {folder, _opts}) when gltf in [".glb", ".gltf"],
    do: Gltf.parse_file(bytes, folder)

  defp parse_shape(".obj", bytes, _asked), do: Obj.parse_file(bytes)
  defp parse_shape(".pcd", bytes, _asked), do: Pcd.parse_file(bytes)
  defp parse_shape(".stl", bytes, _asked), do: Stl.parse_file(bytes)
  defp parse_shape(_ply, bytes, _asked), do: Ply.parse_file(bytes)

  @impl true
  def info(scan),
    do: %{
      name: recording_name(scan),
      created: nil,
      closed?: true,
      live?: false,
      damage: [],
      origin: scan.origin
    }

  defp recording_name(scan), do: Path.basename(scan.path, Path.extname(scan.path))

  @impl true
  def streams(%{data: %module{}} = scan) do
    size = IO.iodata_length(module.encode(scan.data))

    [
      %StreamInfo{
        id: 1,
        name: if(module == Mesh, do: "Mesh", else: "Points"),
        store_name: recording_name(scan),
        store_path: scan.path,
        type: module,
        type_name: inspect(module),
        count: 1,
        size: size,
        stored: size,
        opened: 0,
        closed: 0,
        first: 0,
        last: 0,
        first_creation: 0,
        last_creation: 0
      }
    ]
  end

  @impl true
  def seek(_scan, _info, time), do: {:ok, if(time <= 0, do: 0, else: 1)}

  @impl true
  def read(scan, info, 0, to, limit, _opts) when to >= 0 and limit > 0 do
    message = %Message{
      data: scan.data,
      originating_time: 0,
      creation_time: 0,
      sequence_id: 0,
      source_id: info.id
    }

    {:ok, [message], 1}
  end

  def read(_scan, _info, ordinal, _to, _limit, _opts), do: {:ok, [], ordinal}
end
