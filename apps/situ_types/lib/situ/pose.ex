defmodule Situ.Pose do
  @moduledoc """
  A position and an orientation in space: the origin of one frame in another frame, and its rotation.

  Axes are x forward, y left, z up, in metres, as in \\psi and ROS. A pose maps coordinates in its local frame to
  coordinates in the frame in which it is given:

      iex> camera = Situ.Pose.new({1.0, 0.0, 0.5}, Situ.Quaternion.from_euler(:math.pi() / 2, 0, 0))
      iex> {x, y, z} = Situ.Pose.transform_point(camera, {2.0, 0.0, 0.0})
      iex> {Float.round(x, 9), Float.round(y, 9), z}
      {1.0, 2.0, 0.5}

  `compose(a, b)` expects `b` in the frame of `a` and returns it in the frame in which `a` is given.
  """
  @behaviour Situ.Codec

  alias Situ.{Error, Quaternion, Vector3}

  @enforce_keys [:position, :rotation]
  defstruct [:position, :rotation]

  @type t :: %__MODULE__{position: Vector3.t(), rotation: Quaternion.t()}

  @doc "Builds a pose at `position` (metres) with `rotation`, which is normalized to unit length."
  @spec new(Vector3.t(), Quaternion.t()) :: t()
  def new({_, _, _} = position, rotation \\ {1.0, 0.0, 0.0, 0.0}) do
    case Quaternion.normalize(rotation) do
      {:ok, rotation} ->
        %__MODULE__{position: position, rotation: rotation}

      :error ->
        raise ArgumentError,
              "#{inspect(rotation)} is not a rotation: its length is too small to be normalized"
    end
  end

  @doc "Returns the pose without displacement or rotation."
  @spec identity() :: t()
  def identity, do: %__MODULE__{position: {0.0, 0.0, 0.0}, rotation: Quaternion.identity()}

  @doc """
  Builds the pose at `position` whose x axis points along `forward` and whose z axis is as close to `up` as possible.

      iex> {:ok, pose} = Situ.Pose.look_along({0.0, 0.0, 1.0}, {0.0, 2.0, 0.0})
      iex> {yaw, pitch, roll} = Situ.Quaternion.to_euler(pose.rotation)
      iex> {Float.round(yaw / :math.pi(), 9), Float.round(pitch, 9) + 0.0, Float.round(roll, 9) + 0.0}
      {0.5, 0.0, 0.0}
      iex> {:error, error} = Situ.Pose.look_along({0.0, 0.0, 0.0}, {0.0, 0.0, 1.0})
      iex> error.code
      :degenerate_pose
  """
  @spec look_along(Vector3.t(), Vector3.t(), Vector3.t()) :: {:ok, t()} | {:error, Error.t()}
  def look_along(position, forward, up \\ {0.0, 0.0, 1.0}) do
    with {:ok, {fx, fy, fz} = x} <- Vector3.normalize(forward),
         {:ok, {lx, ly, lz} = y} <- up |> Vector3.cross_product(x) |> Vector3.normalize(),
         {ux, uy, uz} = Vector3.cross_product(x, y),
         {:ok, rotation} <- Quaternion.from_matrix({{fx, lx, ux}, {fy, ly, uy}, {fz, lz, uz}}) do
      {:ok, new(position, rotation)}
    else
      :error ->
        {:error,
         Error.new(
           :degenerate_pose,
           "forward #{inspect(forward)} and up #{inspect(up)} do not define a pose",
           why: "they are parallel, or at least one has length 0",
           fix: "give an up direction that differs from the forward direction"
         )}
    end
  end

  @doc "Returns the pose `b`, which is given in the frame of `a`, in the frame in which `a` is given."
  @spec compose(t(), t()) :: t()
  def compose(%__MODULE__{} = a, %__MODULE__{} = b) do
    {position, rotation} = compose_parts(a.position, a.rotation, b.position, b.rotation)
    %__MODULE__{position: position, rotation: rotation}
  end

  # Combines `transform_point/2` and `Situ.Quaternion.multiply/2`; the guards keep all values in registers.
  defp compose_parts({px, py, pz}, {w, x, y, z}, {vx, vy, vz}, {bw, bx, by, bz})
       when is_float(px) and is_float(py) and is_float(pz) and is_float(w) and is_float(x) and
              is_float(y) and is_float(z) and is_float(vx) and is_float(vy) and is_float(vz) and
              is_float(bw) and is_float(bx) and is_float(by) and is_float(bz) do
    tx = 2.0 * (y * vz - z * vy)
    ty = 2.0 * (z * vx - x * vz)
    tz = 2.0 * (x * vy - y * vx)

    {{px + vx + w * tx + y * tz - z * ty, py + vy + w * ty + z * tx - x * tz,
      pz + vz + w * tz + x * ty - y * tx},
     {w * bw - x * bx - y * by - z * bz, w * bx + x * bw + y * bz - z * by,
      w * by - x * bz + y * bw + z * bx, w * bz + x * by - y * bx + z * bw}}
  end

  defp compose_parts(position, rotation, inner, turn) do
    {Vector3.add(position, Quaternion.rotate_vector(rotation, inner)),
     Quaternion.multiply(rotation, turn)}
  end

  @doc "Returns the pose of the outer frame in the local frame of this pose."
  @spec invert(t()) :: t()
  def invert(%__MODULE__{} = pose) do
    rotation = Quaternion.invert(pose.rotation)

    %__MODULE__{
      position: Quaternion.rotate_vector(rotation, Vector3.scale(pose.position, -1)),
      rotation: rotation
    }
  end

  @doc "Transforms a point from the pose's local frame to the frame in which the pose is given."
  @spec transform_point(t(), Vector3.t()) :: Vector3.t()
  def transform_point(%__MODULE__{} = pose, point),
    do: Vector3.add(pose.position, Quaternion.rotate_vector(pose.rotation, point))

  @doc "Returns the directions of the pose's x, y and z axes."
  @spec axis_directions(t()) :: {Vector3.t(), Vector3.t(), Vector3.t()}
  def axis_directions(%__MODULE__{rotation: q}) do
    {Quaternion.rotate_vector(q, {1.0, 0.0, 0.0}), Quaternion.rotate_vector(q, {0.0, 1.0, 0.0}),
     Quaternion.rotate_vector(q, {0.0, 0.0, 1.0})}
  end

  @doc """
  Interpolates between `a` (ratio 0) and `b` (ratio 1): the position on the straight line, the rotation on the
  shortest arc. Other ratios extrapolate. Returns `nil` if either is `nil`.

      iex> a = Situ.Pose.identity()
      iex> b = Situ.Pose.new({2.0, 0.0, 0.0}, Situ.Quaternion.from_euler(1.0, 0, 0))
      iex> half = Situ.Pose.interpolate(a, b, 0.5)
      iex> {half.position, Float.round(Situ.Quaternion.angle_between(a.rotation, half.rotation), 9)}
      {{1.0, 0.0, 0.0}, 0.5}
  """
  @spec interpolate(t() | nil, t() | nil, number()) :: t() | nil
  def interpolate(%__MODULE__{} = a, %__MODULE__{} = b, ratio) do
    %__MODULE__{
      position: Vector3.lerp(a.position, b.position, ratio),
      rotation: Quaternion.slerp(a.rotation, b.rotation, ratio)
    }
  end

  def interpolate(_a, _b, _ratio), do: nil

  @doc "Converts the pose to a 4x4 matrix, a list of 16 numbers in row order."
  @spec to_matrix(t()) :: [float()]
  def to_matrix(%__MODULE__{position: {x, y, z}, rotation: q}) do
    {{a, b, c}, {d, e, f}, {g, h, i}} = Quaternion.to_matrix(q)
    [a, b, c, x, d, e, f, y, g, h, i, z, 0.0, 0.0, 0.0, 1.0]
  end

  @doc """
  Converts a 4x4 matrix in row order to a pose. Returns an error if the matrix scales, shears or mirrors, or if its
  last row is not `0 0 0 1`.
  """
  @spec from_matrix([number()]) :: {:ok, t()} | {:error, Error.t()}
  def from_matrix([a, b, c, x, d, e, f, y, g, h, i, z, 0, 0, 0, 1]) do
    matrix = {{a, b, c}, {d, e, f}, {g, h, i}}

    case Quaternion.from_matrix(matrix) do
      {:ok, rotation} -> {:ok, new(Vector3.new(x, y, z), rotation)}
      :error -> {:error, not_rigid(matrix)}
    end
  end

  def from_matrix([_, _, _, _, _, _, _, _, _, _, _, _, l, m, n, o] = matrix)
      when l == 0 and m == 0 and n == 0 and o == 1,
      do: matrix |> Enum.take(12) |> Kernel.++([0, 0, 0, 1]) |> from_matrix()

  def from_matrix(other), do: {:error, not_rigid(other)}

  defp not_rigid(matrix) do
    Error.new(:degenerate_pose, "not the matrix of a pose: #{inspect(matrix)}",
      why: "a pose only rotates and translates; it does not scale, shear or mirror",
      fix: "divide the columns by their lengths, or use a mesh or box with a size"
    )
  end

  @impl Situ.Codec
  def codec_name, do: "situ.pose"

  @impl Situ.Codec
  def encode(%__MODULE__{position: {x, y, z}, rotation: {w, i, j, k}}) do
    for value <- [x, y, z, w, i, j, k], into: <<1, 0::56>>, do: <<value::little-float-64>>
  end

  @impl Situ.Codec
  def decode(
        <<1, _::56, x::little-float-64, y::little-float-64, z::little-float-64,
          w::little-float-64, i::little-float-64, j::little-float-64, k::little-float-64>>
      ) do
    # The rotation is not normalized here, so the squares of its components must be in range.
    with true <- Enum.all?([w, i, j, k], &(abs(&1) < 1.0e100)),
         {:ok, _} <- Quaternion.normalize({w, i, j, k}) do
      {:ok, %__MODULE__{position: {x, y, z}, rotation: {w, i, j, k}}}
    else
      false -> {:error, Error.new(:degenerate_pose, "the stored rotation is too large")}
      :error -> {:error, Error.new(:degenerate_pose, "the stored rotation has length 0")}
    end
  end

  def decode(_bytes), do: {:error, Error.new(:bad_pose, "not a stored pose")}
end
