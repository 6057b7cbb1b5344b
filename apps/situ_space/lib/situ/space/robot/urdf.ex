defmodule Situ.Space.Robot.Urdf do
  @moduledoc """
  Reads URDF, ROS's file format for robots: links with their visible shapes, and joints.

  Boxes, cylinders, spheres and meshes (files that `Situ.Space.Scan` reads, such as `.stl`) are read with their poses.
  Materials, collisions, inertias and limits are skipped. Floating and planar joints do not move. Mesh files are
  searched relative to the URDF file: `package://arm/meshes/link.stl` is searched as `meshes/link.stl` and
  `arm/meshes/link.stl` in the file's folder and the four above it. A mesh that is missing or has an unknown format is
  replaced by a text at its position.

  As a recording (`bin/situ studio arm.urdf`) it contains two streams of one message each: `Robot`, the shapes with all
  joints at 0, and `Frames`. Use `Situ.Space.Robot` to move the joints.
  """
  @behaviour Situ.Store.Reader

  alias Situ.{Error, Mesh, Message, Point3, Pose, Quaternion, Transform, Vector3}
  alias Situ.Space.{Robot, Scan, WholeFile, Xml}
  alias Situ.Space.Robot.Solid
  alias Situ.Space.Scan.Text
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
  def read(path), do: WholeFile.read(path, @most, &parse(&1, Path.dirname(path)))

  @doc "Parses a robot from text. Without a folder, meshes are not loaded."
  @spec parse(binary(), Path.t() | nil) :: {:ok, Robot.t()} | {:error, Error.t()}
  def parse(xml, folder \\ nil) do
    case Xml.tree(xml) do
      {:ok, {"robot", given, parts}} -> {:ok, robot(given, parts, folder)}
      {:ok, {other, _, _}} -> bad("its first element is #{String.slice(other, 0, 40)}, not robot")
      {:error, why} -> bad(why)
    end
  catch
    {:bad, why} -> bad(why)
  end

  defp bad(why),
    do: {:error, Error.new(:bad_file, "invalid URDF file", why: why)}

  defp no!(why), do: throw({:bad, why})

  defp robot(given, parts, folder) do
    if length(parts) > @most_parts, do: no!("it has more than #{@most_parts} parts")

    links = for {"link", _, inner} = link <- parts, do: {named(link), shapes(inner, folder)}

    joints = for {"joint", _, _} = joint <- parts, do: joint(joint)
    twice(Enum.map(links, &elem(&1, 0)), "links")
    twice(Enum.map(joints, & &1.name), "joints")
    twice(Enum.map(joints, & &1.child), "joints with the child link")
    links = Map.new(links)

    for %{parent: parent, child: child, name: name} <- joints, link <- [parent, child] do
      if not is_map_key(links, link),
        do:
          no!(
            "the joint #{inspect(name)} refers to the link #{inspect(link)}, which does not exist"
          )
    end

    case Map.keys(links) -- Enum.map(joints, & &1.child) do
      [root] ->
        ordered = order([root], Enum.group_by(joints, & &1.parent))
        if length(ordered) < length(joints), do: no!("some of its links form a cycle")
        %Robot{name: given["name"] || "robot", root: root, links: links, joints: ordered}

      [] ->
        no!("it has no root link: its links form a cycle, or there are none")

      roots ->
        no!("it has #{length(roots)} root links instead of one: #{inspect(roots, limit: 5)}")
    end
  end

  defp twice(names, of) do
    case names -- Enum.uniq(names) do
      [] -> :ok
      [name | _] -> no!("there are two #{of} #{inspect(name)}")
    end
  end

  # Sorts joints so that parents come first.
  defp order([], _by_parent), do: []

  defp order([link | more], by_parent) do
    here = Map.get(by_parent, link, [])
    here ++ order(Enum.map(here, & &1.child) ++ more, by_parent)
  end

  defp named({kind, given, _}),
    do: given["name"] || no!("a #{kind} has no name")

  defp joint({_, given, inner} = joint) do
    name = named(joint)
    kind = @kinds[given["type"]] || no!("the joint #{inspect(name)} has an unknown type")

    axis =
      case inner |> only("axis") |> numbers("xyz", {1.0, 0.0, 0.0}) |> Vector3.normalize() do
        {:ok, axis} -> axis
        :error -> no!("the axis of the joint #{inspect(name)} has no length")
      end

    %{
      name: name,
      kind: kind,
      axis: axis,
      parent: attribute(inner, "parent", "link", name),
      child: attribute(inner, "child", "link", name),
      origin: origin(inner),
      mimic: mimic(only(inner, "mimic"))
    }
  end

  defp attribute(inner, element, key, joint) do
    with {_, %{^key => value}, _} <- only(inner, element),
         do: value,
         else: (_ -> no!("the joint #{inspect(joint)} has no #{element}"))
  end

  defp mimic({_, %{"joint" => name} = given, _}),
    do: {name, number(given["multiplier"] || "1"), number(given["offset"] || "0")}

  defp mimic(_none), do: nil

  defp only(inner, name), do: Enum.find(inner, &(elem(&1, 0) == name))

  defp origin(inner) do
    found = only(inner, "origin")
    {roll, pitch, yaw} = numbers(found, "rpy", {0.0, 0.0, 0.0})
    Pose.new(numbers(found, "xyz", {0.0, 0.0, 0.0}), Quaternion.from_euler(yaw, pitch, roll))
  end

  defp numbers({name, given, _}, key, _default) when is_map_key(given, key) do
    case String.split(given[key]) do
      [_, _, _] = words -> words |> Enum.map(&number/1) |> List.to_tuple()
      _ -> no!("`#{key}` of the element #{name} must have three numbers")
    end
  end

  defp numbers(_element, _key, default), do: default

  defp number(text) do
    case text |> to_string() |> String.trim() |> Text.float() do
      {:ok, x} when abs(x) < 1.0e6 -> x
      _ -> no!("#{inspect(String.slice(to_string(text), 0, 40))} is not a number below a million")
    end
  end

  defp shapes(inner, folder) do
    for {"visual", _, visual} <- inner, {_, _, geometry} <- [only(visual, "geometry")] do
      origin = origin(visual)

      case geometry do
        [{kind, given, _} | _] -> placed(shape(kind, given, folder), origin)
        [] -> no!("a geometry contains no shape")
      end
    end
  end

  defp placed(%Mesh{} = mesh, origin), do: %{mesh | pose: origin}

  defp placed(why, %Pose{position: {x, y, z}}) when is_binary(why), do: {why, Point3.new(x, y, z)}

  defp shape("box", given, _), do: Solid.box(numbers({"box", given, []}, "size", {1.0, 1.0, 1.0}))

  defp shape("cylinder", given, _),
    do: Solid.cylinder(number(given["radius"]), number(given["length"]))

  defp shape("sphere", given, _), do: Solid.sphere(number(given["radius"]))

  defp shape("mesh", %{"filename" => name} = given, folder) do
    scale = numbers({"mesh", given, []}, "scale", {1.0, 1.0, 1.0})

    with {:ok, path} <- find(name, folder),
         {:ok, %Mesh{} = mesh} <- Scan.read(path, axes: :own) do
      with why when is_binary(why) <- scaled(mesh, scale), do: "#{Path.basename(name)}: #{why}"
    else
      {:ok, _cloud} -> "#{Path.basename(name)} has no surface"
      {:error, %Error{} = error} -> "#{Path.basename(name)}: #{error.why || error.what}"
      {:error, why} -> "#{Path.basename(name)}: #{why}"
    end
  end

  defp shape(kind, _given, _folder), do: "unknown shape #{String.slice(kind, 0, 40)}"

  defp scaled(mesh, {sx, sy, sz}) do
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
  defp find(_name, nil), do: {:error, "no folder to look in"}

  defp find(name, folder) do
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

      String.downcase(Path.extname(path)) not in Scan.extensions() ->
        {:error, "this file format is not supported"}

      true ->
        candidates(folder, parts, package)
        |> Enum.find(&File.regular?/1)
        |> then(&if(&1, do: {:ok, &1}, else: {:error, "the file does not exist"}))
    end
  end

  defp candidates(folder, parts, false), do: [Path.join([folder | parts])]

  defp candidates(folder, parts, true) do
    folder
    |> Path.expand()
    |> Stream.iterate(&Path.dirname/1)
    |> Stream.take(5)
    |> Stream.flat_map(&for(p <- [parts, tl(parts)], p != [], do: Path.join([&1 | p])))
  end

  @impl true
  def extensions, do: [".urdf"]

  @impl true
  def open(path, _opts),
    do: with({:ok, robot} <- read(path), do: {:ok, %__MODULE__{path: path, robot: robot}})

  @impl true
  def info(urdf),
    do: %{name: name(urdf), created: nil, closed?: true, live?: false, damage: []}

  defp name(urdf), do: Path.basename(urdf.path, Path.extname(urdf.path))

  @impl true
  def streams(urdf) do
    for {name, id, type} <- [{"Robot", 1, :map}, {"Frames", 2, {:list, Transform}}] do
      %StreamInfo{
        id: id,
        name: name,
        store_name: name(urdf),
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
      if info.name == "Robot", do: Robot.shapes(urdf.robot), else: Robot.transforms(urdf.robot)

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
