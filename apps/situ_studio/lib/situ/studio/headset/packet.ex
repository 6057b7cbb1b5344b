defmodule Situ.Studio.Headset.Packet do
  @moduledoc false
  # Parses one tracking sample of a headset, as its page sends it: a header (`headset` in `priv/frames.json`), and then
  #
  # | from byte | contents |
  # |---|---|
  # | 16 | poses, each 7 32-bit floats (x, y, z, and the rotation's x, y, z, w): head, 25 joints of each hand, gaze |
  # | last | planes, as JSON: `[{"label", "pose": [7 numbers], "polygon": [[x, z], ...]}]` |
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.{JSON, Point3, Pose, Quaternion, Ray3, Rectangle3, Skeleton}
  alias Situ.Studio.FrameSchema

  @kind FrameSchema.code(:device, :headset)

  @pose 28
  @most_planes 256
  @most_corners 1_024

  @fingers [:index_finger, :middle_finger, :ring_finger, :pinky_finger]
  @bones_of [:metacarpal, :phalanx_proximal, :phalanx_intermediate, :phalanx_distal, :tip]
  @thumb [:thumb_metacarpal, :thumb_phalanx_proximal, :thumb_phalanx_distal, :thumb_tip]
  @chains [@thumb | for(f <- @fingers, do: for(b <- @bones_of, do: :"#{f}_#{b}"))]
  # The order is WebXR's.
  @joints [:wrist | List.flatten(@chains)]
  @bones [
    {:wrist, :palm}
    | Enum.flat_map(@chains, fn chain -> Enum.zip([:wrist | chain], chain) end)
  ]

  @typedoc "A flat surface: the headset's label for it (may be empty), its outline, and the bounding rectangle."
  @type plane :: %{label: String.t(), polygon: [Point3.t()], rectangle: Rectangle3.t()}

  @doc "Returns the joints of a hand."
  @spec hand_joints() :: [atom()]
  def hand_joints, do: [:palm | @joints]

  @doc """
  Returns the page's time and the parsed values, or `:error` if the bytes are not a valid sample.

  Poses of WebXR have x to the right, y up and z backward; here they become x forward, y left, z up:

      iex> pose = for value <- [0.0, 1.6, -2.0, 0.0, 0.0, 0.0, 1.0], into: <<>>, do: <<value::little-float-32>>
      iex> {5.0, [head: head]} =
      ...>   Situ.Studio.Headset.Packet.parse(<<4, 0, 0::48, 5.0::little-float-64>> <> pose)
      iex> {x, y, z} = head.position
      iex> {Float.round(x, 3), abs(y), Float.round(z, 3)}
      {2.0, 0.0, 1.6}
      iex> Situ.Studio.Headset.Packet.parse("anything")
      :error
  """
  @spec parse(binary()) :: {float(), [{atom(), term()}]} | :error
  def parse(<<@kind, _::binary>> = bytes) do
    with {%{flags: flags, time: ms}, rest} <- FrameSchema.decode(:headset, bytes),
         has = FrameSchema.decode_flags(:headset_flag, flags),
         {:ok, [head], rest} <- parse_poses(rest, 1),
         {:ok, left_joints, rest} <- parse_poses(rest, 25 * has.left),
         {:ok, right_joints, rest} <- parse_poses(rest, 25 * has.right),
         {:ok, ray, rest} <- parse_poses(rest, has.gaze),
         {:ok, planes} <- parse_planes(has.planes, rest) do
      {ms,
       [head: head] ++
         build_hand(:left, left_joints) ++
         build_hand(:right, right_joints) ++
         Enum.map(ray, &{:gaze, Ray3.from_pose(&1)}) ++
         parse_selection(has) ++ planes}
    else
      _ -> :error
    end
  end

  def parse(_bytes), do: :error

  defp parse_selection(%{selected: 0}), do: []

  defp parse_selection(%{left_selects: left, right_selects: right}),
    do: [select: %{left: left == 1, right: right == 1}]

  defp parse_poses(bytes, n) when byte_size(bytes) >= n * @pose do
    <<here::binary-pinned_size(n)-unit(224), rest::binary>> = bytes

    found =
      for <<x::little-float-32, y::little-float-32, z::little-float-32, i::little-float-32,
            j::little-float-32, k::little-float-32, w::little-float-32 <- here>>,
          {:ok, pose} <- [build_pose({x, y, z}, {w, i, j, k})],
          do: pose

    # Poses with NaN, infinite numbers or invalid rotations were left out.
    if length(found) == n, do: {:ok, found, rest}, else: :error
  end

  defp parse_poses(_bytes, _n), do: :error

  defp build_pose(position, {w, i, j, k}) do
    with {:ok, rotation} <- Quaternion.normalize({w, -k, -i, j}),
         do: {:ok, Pose.new(convert_axes(position), rotation)}
  end

  defp convert_axes({x, y, z}), do: {-z, -x, y}

  defp build_hand(_side, []), do: []

  defp build_hand(side, poses) do
    joints = @joints |> Enum.zip(poses) |> Map.new()
    from = joints.middle_finger_metacarpal
    between = Pose.interpolate(from, joints.middle_finger_phalanx_proximal, 0.5)
    joints = Map.put(joints, :palm, %{between | rotation: from.rotation})
    [{side, Skeleton.new!(joints, @bones, id: side)}]
  end

  defp parse_planes(0, ""), do: {:ok, []}

  defp parse_planes(1, json) do
    with {:ok, rows} when is_list(rows) and length(rows) <= @most_planes <- JSON.decode(json),
         planes = Enum.map(rows, &parse_plane/1),
         false <- :error in planes do
      {:ok, [planes: planes]}
    else
      _ -> :error
    end
  end

  defp parse_planes(_, _), do: :error

  defp parse_plane(%{"pose" => [x, y, z, i, j, k, w] = numbers, "polygon" => corners} = row)
       when is_list(corners) and corners != [] and length(corners) <= @most_corners do
    with true <- Enum.all?(numbers, &valid_coordinate?/1),
         true <- Enum.all?(corners, &valid_corner?/1),
         label when is_binary(label) and byte_size(label) <= 100 <- row["label"],
         {:ok, pose} <- build_pose({x / 1, y / 1, z / 1}, {w / 1, i / 1, j / 1, k / 1}) do
      %{
        label: label,
        polygon: outline_points(pose, corners),
        rectangle: bounding_rectangle(pose, corners)
      }
    else
      _ -> :error
    end
  end

  defp parse_plane(_row), do: :error

  defp valid_coordinate?(value), do: is_number(value) and abs(value) < 1.0e6

  defp valid_corner?([x, z]), do: valid_coordinate?(x) and valid_coordinate?(z)
  defp valid_corner?(_), do: false

  defp outline_points(pose, corners) do
    for [x, z] <- corners do
      {x, y, z} = Pose.transform_point(pose, convert_axes({x / 1, 0.0, z / 1}))
      Point3.new(x, y, z)
    end
  end

  # The normal of a plane points up, and the normal of a rectangle is its x axis.
  defp bounding_rectangle(pose, corners) do
    {{left, right}, {back, front}} =
      {corners |> Enum.map(&hd/1) |> Enum.min_max(),
       corners |> Enum.map(&List.last/1) |> Enum.min_max()}

    middle = Pose.new(convert_axes({(left + right) / 2, 0.0, (back + front) / 2}))

    upright =
      Pose.new({0.0, 0.0, 0.0}, Quaternion.from_axis_angle({0.0, 1.0, 0.0}, -:math.pi() / 2))

    pose
    |> Pose.compose(middle)
    |> Pose.compose(upright)
    |> Rectangle3.new!(right - left, front - back)
  end
end
