defmodule Situ.Space.Robot.Urdf do
  @moduledoc """
  Reads URDF, ROS's file format for robots: links with their visible shapes, and joints.

  Boxes, cylinders, spheres and meshes (in the formats that `Situ.Space` lists, such as `.stl`) are read with
  their poses. Materials, collisions, inertias and limits are skipped. Floating and planar joints do not move. Paths
  of mesh files are relative to the URDF file: `package://arm/meshes/link.stl` is searched for as `meshes/link.stl`
  and `arm/meshes/link.stl` in the file's folder and the four above it. A mesh that is missing or has an unknown
  format is replaced by a text at its position.

  As a recording (`bin/situ studio arm.urdf`) it contains two streams of one message each: `Robot`, the shapes with all
  joints at 0, and `Frames`. Use `Situ.Space.Robot` to move the joints.
  """
  # Erlang's SAX parser reads these files of some kilobytes. The crate `urdf-rs` returns only the
  # elements, each of which would have to become a term, and `urdf-loader` in the page would not
  # help pipelines. Each joint state sends all triangles again, which is fine for simple shapes
  # and slow for scanned ones.
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format

  alias Situ.{Error, Mesh, Message, Point3, Pose, Quaternion, Transform, Vector3, Xml}
  alias Situ.Space.{Robot, GeometryFile, FileParser}
  alias Situ.Space.Robot.Primitives
  alias Situ.Space.GeometryFile.NumberParser
  alias Situ.Store.StreamInfo

  @enforce_keys [:path, :robot]
  defstruct [:path, :robot]

  @type t :: %__MODULE__{path: Path.t(), robot: Robot.t()}
  @most 20_000_000
  @most_parts 5_000
  @kinds %{
    "fixed" => :fixed,
    "floating" => :fixed,
    "planar" => :fixed,
    "revolute" => :turning,
    "continuous" => :turning,
    "prismatic" => :sliding
  }

  @doc "Reads the robot of a file. Errors: `:no_file`, `:too_large`, `:bad_file`."
  @spec read(Path.t()) :: {:ok, Robot.t()} | {:error, Error.t()}
  def read(path), do: FileParser.read_and_parse(path, @most, &parse(&1, Path.dirname(path)))

  @doc "Parses a robot from text. Without a folder, meshes are not loaded."
  @spec parse(binary(), Path.t() | nil) :: {:ok, Robot.t()} | {:error, Error.t()}
  def parse(xml, folder \\ nil) do
    case Xml.parse(xml, texts: false) do
      {:ok, {"robot", given, parts}} ->
        {:ok, build_robot(given, parts, folder)}

      {:ok, {other, _, _}} ->
        file_error("its first element is #{String.slice(other, 0, 40)}, not robot")

      {:error, why} ->
        file_error(why)
    end
  catch
    {:bad, why} -> file_error(why)
  end

  defp file_error(why),
    do: {:error, Error.new(:bad_file, "invalid URDF file", why: why)}

  defp reject_file!(why), do: throw({:bad, why})

  defp build_robot(given, parts, folder) do
    if length(parts) > @most_parts, do: reject_file!("it has more than #{@most_parts} parts")

    links =
      for {"link", _, inner} = link <- parts, do: {fetch_name!(link), parse_shapes(inner, folder)}

    joints = for {"joint", _, _} = joint <- parts, do: parse_joint(joint)
    reject_duplicates!(Enum.map(links, &elem(&1, 0)), "links")
    reject_duplicates!(Enum.map(joints, & &1.name), "joints")
    reject_duplicates!(Enum.map(joints, & &1.child), "joints with the child link")
    links = Map.new(links)

    for %{parent: parent, child: child, name: name} <- joints, link <- [parent, child] do
      if not is_map_key(links, link),
        do:
          reject_file!(
            "the joint #{inspect(name)} refers to the link #{inspect(link)}, which does not exist"
          )
    end

    case Map.keys(links) -- Enum.map(joints, & &1.child) do
      [root] ->
        ordered = order_joints([root], Enum.group_by(joints, & &1.parent))
        if length(ordered) < length(joints), do: reject_file!("some of its links form a cycle")
        %Robot{name: given["name"] || "robot", root: root, links: links, joints: ordered}

      [] ->
        reject_file!("it has no root link: its links form a cycle, or there are none")

      roots ->
        reject_file!(
          "it has #{length(roots)} root links instead of one: #{inspect(roots, limit: 5)}"
        )
    end
  end

  defp reject_duplicates!(names, of) do
    case names -- Enum.uniq(names) do
      [] -> :ok
      [name | _] -> reject_file!("there are two #{of} #{inspect(name)}")
    end
  end

  # Sorts joints so that parents come first.
  defp order_joints([], _by_parent), do: []

  defp order_joints([link | more], by_parent) do
    here = Map.get(by_parent, link, [])
    here ++ order_joints(Enum.map(here, & &1.child) ++ more, by_parent)
  end

  defp fetch_name!({kind, given, _}),
    do: given["name"] || reject_file!("a #{kind} has no name")

  defp parse_joint({_, given, inner} = joint) do
    name = fetch_name!(joint)
    kind = @kinds[given["type"]] || reject_file!("the joint #{inspect(name)} has an unknown type")

    axis =
      case inner
           |> find_child("axis")
           |> parse_vector("xyz", {1.0, 0.0, 0.0})
           |> Vector3.normalize() do
        {:ok, axis} -> axis
        :error -> reject_file!("the axis of the joint #{inspect(name)} has no length")
      end

    %{
      name: name,
      kind: kind,
      axis: axis,
      parent: fetch_attribute!(inner, "parent", "link", name),
      child: fetch_attribute!(inner, "child", "link", name),
      origin: parse_origin(inner),
      mimic: parse_mimic(find_child(inner, "mimic"))
    }
  end

  defp fetch_attribute!(inner, element, key, joint) do
    with {_, %{^key => value}, _} <- find_child(inner, element),
         do: value,
         else: (_ -> reject_file!("the joint #{inspect(joint)} has no #{element}"))
  end

  defp parse_mimic({_, %{"joint" => name} = given, _}),
    do: {name, parse_number(given["multiplier"] || "1"), parse_number(given["offset"] || "0")}

  defp parse_mimic(_none), do: nil

  defp find_child(inner, name), do: Enum.find(inner, &(elem(&1, 0) == name))

  defp parse_origin(inner) do
    found = find_child(inner, "origin")
    {roll, pitch, yaw} = parse_vector(found, "rpy", {0.0, 0.0, 0.0})
    Pose.new(parse_vector(found, "xyz", {0.0, 0.0, 0.0}), Quaternion.from_euler(yaw, pitch, roll))
  end

  defp parse_vector({name, given, _}, key, _default) when is_map_key(given, key) do
    case String.split(given[key]) do
      [_, _, _] = words -> words |> Enum.map(&parse_number/1) |> List.to_tuple()
      _ -> reject_file!("`#{key}` of the element #{name} must have three numbers")
    end
  end

  defp parse_vector(_element, _key, default), do: default

  defp parse_number(text) do
    case text |> to_string() |> String.trim() |> NumberParser.parse_float() do
      {:ok, x} when abs(x) < 1.0e6 ->
        x

      _ ->
        reject_file!(
          "#{inspect(String.slice(to_string(text), 0, 40))} is not a number below a million"
        )
    end
  end

  defp parse_shapes(inner, folder) do
    for {"visual", _, visual} <- inner, {_, _, geometry} <- [find_child(visual, "geometry")] do
      origin = parse_origin(visual)

      case geometry do
        [{kind, given, _} | _] -> put_origin(build_shape(kind, given, folder), origin)
        [] -> reject_file!("a geometry contains no shape")
      end
    end
  end

  defp put_origin(%Mesh{} = mesh, origin), do: %{mesh | pose: origin}

  defp put_origin(why, %Pose{position: {x, y, z}}) when is_binary(why),
    do: {why, Point3.new(x, y, z)}

  defp build_shape("box", given, _),
    do: Primitives.box(parse_vector({"box", given, []}, "size", {1.0, 1.0, 1.0}))

  defp build_shape("cylinder", given, _),
    do: Primitives.cylinder(parse_number(given["radius"]), parse_number(given["length"]))

  defp build_shape("sphere", given, _), do: Primitives.sphere(parse_number(given["radius"]))

  defp build_shape("mesh", %{"filename" => name} = given, folder) do
    scale = parse_vector({"mesh", given, []}, "scale", {1.0, 1.0, 1.0})

    with {:ok, path} <- resolve_file(name, folder),
         {:ok, %Mesh{} = mesh} <- GeometryFile.read(path, axes: :own) do
      with why when is_binary(why) <- scale_mesh(mesh, scale),
           do: "#{Path.basename(name)}: #{why}"
    else
      {:ok, _cloud} -> "#{Path.basename(name)} has no surface"
      {:error, %Error{} = error} -> "#{Path.basename(name)}: #{error.why || error.what}"
      {:error, why} -> "#{Path.basename(name)}: #{why}"
    end
  end

  defp build_shape(kind, _given, _folder), do: "unknown shape #{String.slice(kind, 0, 40)}"

  defp scale_mesh(mesh, {sx, sy, sz}) do
    vertices =
      for <<x::little-float-32, y::little-float-32, z::little-float-32 <- mesh.vertices>>,
          abs(x) + abs(y) + abs(z) < 1.0e9,
          into: <<>>,
          do: <<x * sx::little-float-32, y * sy::little-float-32, z * sz::little-float-32>>

    if byte_size(vertices) == byte_size(mesh.vertices),
      do: %{mesh | vertices: vertices},
      else: "a vertex is not finite"
  end

  # A robot file is untrusted, so it may only refer to files in its own folders.
  defp resolve_file(_name, nil), do: {:error, "no folder to look in"}

  defp resolve_file(name, folder) do
    {package, path} =
      case name do
        "package://" <> rest -> {true, rest}
        "file://" <> rest -> {false, rest}
        path -> {false, path}
      end

    parts = Path.split(path)

    cond do
      Path.type(path) != :relative or ".." in parts or path == "" ->
        {:error, "the path is outside the robot's folders"}

      String.downcase(Path.extname(path)) not in GeometryFile.extensions() ->
        {:error, "this file format is not supported"}

      true ->
        candidate_paths(folder, parts, package)
        |> Enum.find(&File.regular?/1)
        |> then(&if(&1, do: {:ok, &1}, else: {:error, "the file does not exist"}))
    end
  end

  defp candidate_paths(folder, parts, false), do: [Path.join([folder | parts])]

  defp candidate_paths(folder, parts, true) do
    folder
    |> Path.expand()
    |> Stream.iterate(&Path.dirname/1)
    |> Stream.take(5)
    |> Stream.flat_map(&for(p <- [parts, tl(parts)], p != [], do: Path.join([&1 | p])))
  end

  @impl true
  def extensions, do: [".urdf"]

  @impl true
  def kinds,
    do: [
      %Situ.Recording.FileKind{
        name: :urdf,
        title: "URDF robot",
        extensions: extensions(),
        open: __MODULE__
      }
    ]

  @impl true
  def open(path, _opts),
    do: with({:ok, robot} <- read(path), do: {:ok, %__MODULE__{path: path, robot: robot}})

  @impl true
  def info(urdf),
    do: %{name: recording_name(urdf), created: nil, closed?: true, live?: false, damage: []}

  defp recording_name(urdf), do: Path.basename(urdf.path, Path.extname(urdf.path))

  @impl true
  def streams(urdf) do
    for {name, id, type} <- [{"Robot", 1, :map}, {"Frames", 2, {:list, Transform}}] do
      %StreamInfo{
        id: id,
        name: name,
        store_name: recording_name(urdf),
        store_path: urdf.path,
        type: type,
        type_name: Situ.Type.to_string(type),
        count: 1,
        size: 0,
        stored: 0,
        opened: 0,
        closed: 0,
        first: 0,
        last: 0,
        first_creation: 0,
        last_creation: 0
      }
    end
  end

  @impl true
  def seek(_urdf, _info, time), do: {:ok, if(time <= 0, do: 0, else: 1)}

  @impl true
  def read(urdf, info, 0, to, limit, _opts) when to >= 0 and limit > 0 do
    data =
      if info.name == "Robot",
        do: Robot.link_shapes(urdf.robot),
        else: Robot.link_transforms(urdf.robot)

    message = %Message{
      data: data,
      originating_time: 0,
      creation_time: 0,
      sequence_id: 0,
      source_id: info.id
    }

    {:ok, [message], 1}
  end

  def read(_urdf, _info, ordinal, _to, _limit, _opts), do: {:ok, [], ordinal}
end
