defmodule Situ.Quaternion do
  @moduledoc """
  Rotations as unit quaternions `{w, x, y, z}`.

  `{w, x, y, z}` and its negative are the same rotation. Functions expect unit length; use `normalize/1` to restore
  it.

      iex> quarter = Situ.Quaternion.from_axis_angle({0.0, 0.0, 1.0}, :math.pi() / 2)
      iex> {x, y, z} = Situ.Quaternion.rotate_vector(quarter, {1.0, 0.0, 0.0})
      iex> {Float.round(x, 9) + 0.0, Float.round(y, 9), z}
      {0.0, 1.0, 0.0}
  """
  alias Situ.Vector3

  @type t :: {float(), float(), float(), float()}
  @typedoc "Three rows of three numbers."
  @type matrix :: {Vector3.t(), Vector3.t(), Vector3.t()}

  @doc "Returns the rotation by angle 0."
  @spec identity() :: t()
  def identity, do: {1.0, 0.0, 0.0, 0.0}

  @doc "Builds a right-handed rotation by `angle` radians around a unit `axis`."
  @spec from_axis_angle(Vector3.t(), number()) :: t()
  def from_axis_angle({x, y, z}, angle) do
    s = :math.sin(angle / 2)
    {:math.cos(angle / 2), x * s, y * s, z * s}
  end

  @doc """
  Returns the unit axis and the angle (`0.0..pi`) of a rotation. If the angle is 0, the axis is x.

      iex> Situ.Quaternion.to_axis_angle(Situ.Quaternion.identity())
      {{1.0, 0.0, 0.0}, 0.0}
  """
  @spec to_axis_angle(t()) :: {Vector3.t(), float()}
  def to_axis_angle({w, x, y, z}) do
    {w, v} = if w < 0, do: {-w, {-x, -y, -z}}, else: {w, {x, y, z}}

    case Vector3.normalize(v) do
      {:ok, axis} -> {axis, 2 * :math.atan2(Vector3.norm(v), w)}
      :error -> {{1.0, 0.0, 0.0}, 0.0}
    end
  end

  @doc "Builds a rotation by yaw (around z), then pitch (around the new y), then roll (around the new x), in radians."
  @spec from_euler(yaw :: number(), pitch :: number(), roll :: number()) :: t()
  def from_euler(yaw, pitch, roll) do
    from_axis_angle({0.0, 0.0, 1.0}, yaw)
    |> multiply(from_axis_angle({0.0, 1.0, 0.0}, pitch))
    |> multiply(from_axis_angle({1.0, 0.0, 0.0}, roll))
  end

  @doc """
  Returns yaw, pitch and roll in radians, as used by `from_euler/3`. Pitch is in `-pi/2..pi/2`. At either limit, only
  the difference or sum of yaw and roll is defined, and roll is 0.
  """
  @spec to_euler(t()) :: {yaw :: float(), pitch :: float(), roll :: float()}
  def to_euler(q) do
    {{r00, r01, _}, {r10, r11, _}, {r20, r21, r22}} = to_matrix(q)

    cond do
      r20 > 1 - 1.0e-12 -> {:math.atan2(-r01, r11), -:math.pi() / 2, 0.0}
      r20 < -1 + 1.0e-12 -> {:math.atan2(-r01, r11), :math.pi() / 2, 0.0}
      true -> {:math.atan2(r10, r00), :math.asin(-r20), :math.atan2(r21, r22)}
    end
  end

  @doc "Combines two rotations: `b` is applied first, then `a`."
  @spec multiply(t(), t()) :: t()
  def multiply({aw, ax, ay, az}, {bw, bx, by, bz}) do
    {aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
     aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw}
  end

  @doc "Returns the inverse rotation."
  @spec invert(t()) :: t()
  def invert({w, x, y, z}), do: {w, -x, -y, -z}

  @doc "Rotates a vector."
  @spec rotate_vector(t(), Vector3.t()) :: Vector3.t()
  def rotate_vector({w, x, y, z}, {vx, vy, vz}) do
    # v + 2w (u x v) + 2 u x (u x v), with u the quaternion's vector part.
    {tx, ty, tz} = {2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)}
    {vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx}
  end

  @large 1.0e100

  @doc """
  Returns the quaternion scaled to unit length, or `:error` if it is too short to be a rotation.

      iex> Situ.Quaternion.normalize({3.0e200, 0.0, 4.0e200, 0.0})
      {:ok, {0.6, 0.0, 0.8, 0.0}}
  """
  @spec normalize(t()) :: {:ok, t()} | :error
  def normalize({w, x, y, z} = q) do
    case max(max(abs(w), abs(x)), max(abs(y), abs(z))) do
      # Squares of numbers this large would overflow.
      largest when largest > @large ->
        normalize_length({w / largest, x / largest, y / largest, z / largest})

      _ ->
        normalize_length(q)
    end
  end

  defp normalize_length({w, x, y, z}) do
    case :math.sqrt(w * w + x * x + y * y + z * z) do
      length when length < 1.0e-12 -> :error
      length -> {:ok, {w / length, x / length, y / length, z / length}}
    end
  end

  @doc "Returns the angle in radians, `0.0..pi`, of the rotation from `a` to `b`."
  @spec angle_between(t(), t()) :: float()
  def angle_between(a, b), do: a |> invert() |> multiply(b) |> to_axis_angle() |> elem(1)

  @doc """
  Interpolates on the shortest arc from `a` (ratio 0) to `b` (ratio 1) at constant speed; other ratios extrapolate.
  Source: K. Shoemake, Animating Rotation with Quaternion Curves, 1985.
  """
  @spec slerp(t(), t(), number()) :: t()
  def slerp({aw, ax, ay, az}, {bw, bx, by, bz}, ratio)
      when is_float(aw) and is_float(ax) and is_float(ay) and is_float(az) and is_float(bw) and
             is_float(bx) and is_float(by) and is_float(bz) do
    # This is the rotation from a to b; the guards keep all values in registers.
    w = aw * bw + ax * bx + ay * by + az * bz
    x = aw * bx - ax * bw - ay * bz + az * by
    y = aw * by + ax * bz - ay * bw - az * bx
    z = aw * bz - ax * by + ay * bx - az * bw
    sine = :math.sqrt(x * x + y * y + z * z)

    if sine < 1.0e-12 do
      {aw, ax, ay, az}
    else
      # Uses the sign of the quaternion that gives the shorter arc.
      half = if w < 0.0, do: :math.atan2(-sine, -w), else: :math.atan2(sine, w)
      c = :math.cos(ratio * half)
      s = :math.sin(ratio * half) / sine

      {aw * c - s * (ax * x + ay * y + az * z), ax * c + s * (aw * x + ay * z - az * y),
       ay * c + s * (aw * y - ax * z + az * x), az * c + s * (aw * z + ax * y - ay * x)}
    end
  end

  def slerp(a, b, ratio), do: slerp(to_floats(a), to_floats(b), ratio)

  defp to_floats({w, x, y, z}), do: {w * 1.0, x * 1.0, y * 1.0, z * 1.0}

  @doc "Converts the rotation to a matrix whose columns are the rotated x, y and z axes."
  @spec to_matrix(t()) :: matrix()
  def to_matrix({w, x, y, z}) do
    {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
     {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
     {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}}
  end

  @doc """
  Converts a matrix to a rotation. Its columns must be orthogonal unit vectors and right-handed (within `tolerance`);
  returns `:error` otherwise. Source: S. W. Shepperd, Quaternion from Rotation Matrix, 1978.
  """
  @spec from_matrix(matrix(), float()) :: {:ok, t()} | :error
  def from_matrix({{a, b, c}, {d, e, f}, {g, h, i}} = matrix, tolerance \\ 1.0e-3) do
    if rotation_matrix?(matrix, tolerance) do
      normalize(
        cond do
          a + e + i > 0 ->
            with_root(a + e + i, fn s -> {s / 4, (h - f) / s, (c - g) / s, (d - b) / s} end)

          a >= e and a >= i ->
            with_root(a - e - i, fn s -> {(h - f) / s, s / 4, (b + d) / s, (c + g) / s} end)

          e >= i ->
            with_root(e - a - i, fn s -> {(c - g) / s, (b + d) / s, s / 4, (f + h) / s} end)

          true ->
            with_root(i - a - e, fn s -> {(d - b) / s, (c + g) / s, (f + h) / s, s / 4} end)
        end
      )
    else
      :error
    end
  end

  defp with_root(trace, fun), do: fun.(2 * :math.sqrt(max(1 + trace, 1.0e-12)))

  defp rotation_matrix?({r0, r1, r2}, tolerance) do
    products = [
      {r0, r0, 1},
      {r1, r1, 1},
      {r2, r2, 1},
      {r0, r1, 0},
      {r0, r2, 0},
      {r1, r2, 0},
      {Vector3.cross_product(r0, r1), r2, 1}
    ]

    Enum.all?(products, fn {a, b, expected} ->
      abs(Vector3.dot_product(a, b) - expected) <= tolerance
    end)
  end
end
