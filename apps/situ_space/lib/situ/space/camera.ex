defmodule Situ.Space.Camera do
  @moduledoc """
  Projects points in space to pixels and back, through a lens with distortion.

  The camera looks along its x axis, with y to its left and z up. Pixels count from the top left corner, x to the right
  and y down. The model is the pinhole camera with rational Brown-Conrady distortion, as in the calibrations of OpenCV
  and \\psi.

      iex> camera = Situ.CameraIntrinsics.new!(width: 640, height: 480, focal: {500, 500})
      iex> Situ.Space.Camera.project(camera, {2.0, 0.4, 0.2})
      {:ok, {220.0, 190.0}}
      iex> Situ.Space.Camera.unproject(camera, {220.0, 190.0}, 2.0)
      {:ok, {2.0, 0.4, 0.2}}
      iex> Situ.Space.Camera.project(camera, {-1.0, 0.0, 0.0})
      {:error, :behind}
  """
  alias Situ.{CameraIntrinsics, CameraView, Pose, Ray3, Vector3}

  @type pixel :: {number(), number()}
  @typedoc "A point on the plane at distance 1, to the right and down, in units of that distance."
  @type normalized :: {float(), float()}

  @doc """
  Distorts a point on the plane at distance 1, in closed form: radially by
  `(1 + k1 r2 + k2 r4 + k3 r6) / (1 + k4 r2 + k5 r4 + k6 r6)`, tangentially by p0 and p1.
  """
  @spec distort(CameraIntrinsics.t(), normalized()) :: normalized()
  def distort(%CameraIntrinsics{radial: {k1, k2, k3, k4, k5, k6}, tangential: {p0, p1}}, {x, y}) do
    r2 = x * x + y * y
    d = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))

    {x * d + p1 * (r2 + 2 * x * x) + 2 * p0 * x * y,
     y * d + p0 * (r2 + 2 * y * y) + 2 * p1 * x * y}
  end

  defp radial_factor({k1, k2, k3, k4, k5, k6}, r2),
    do: (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))

  @steps 100
  @enough 1.0e-16

  @doc """
  Returns the point that `distort/2` moves to this one. Newton's method starts at the point itself and takes at most
  100 steps until the squared error is below 1e-16. Returns `:error` if the distortion cannot be inverted there: the
  method does not converge, or it converges only on the far side of the lens, where the model is mirrored.
  """
  @spec undistort(CameraIntrinsics.t(), normalized()) :: {:ok, normalized()} | :error
  def undistort(%CameraIntrinsics{} = camera, target) do
    with {:ok, {x, y} = point} <- iterate_newton(camera, target, target, @steps),
         do: if(radial_factor(camera.radial, x * x + y * y) > 0, do: {:ok, point}, else: :error)
  end

  defp iterate_newton(_camera, _target, _guess, 0), do: :error

  defp iterate_newton(camera, {tx, ty} = target, {x, y} = guess, steps) do
    {dx, dy} = distort(camera, guess)
    {ex, ey} = {dx - tx, dy - ty}

    if ex * ex + ey * ey < @enough do
      {:ok, guess}
    else
      {a, b, c, d} = distortion_jacobian(camera, guess)
      determinant = a * d - b * c

      if abs(determinant) < @enough,
        do: :error,
        else:
          iterate_newton(
            camera,
            target,
            {x - (d * ex - b * ey) / determinant, y - (a * ey - c * ex) / determinant},
            steps - 1
          )
    end
  rescue
    ArithmeticError -> :error
  end

  # The derivatives of distort/2: dx/dx, dx/dy, dy/dx, dy/dy.
  defp distortion_jacobian(%{radial: {k1, k2, k3, k4, k5, k6}, tangential: {p0, p1}}, {x, y}) do
    r2 = x * x + y * y
    above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    d = above / below

    slope =
      ((k1 + r2 * (2 * k2 + 3 * r2 * k3)) * below - above * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) /
        (below * below)

    cross = 2 * x * y * slope + 2 * p1 * y + 2 * p0 * x

    {d + 2 * x * x * slope + 6 * p1 * x + 2 * p0 * y, cross, cross,
     d + 2 * y * y * slope + 6 * p0 * y + 2 * p1 * x}
  end

  @schema [
    distort: [
      type: :boolean,
      default: true,
      doc: "Whether to apply the lens distortion; `false` is the ideal pinhole."
    ],
    outside: [
      type: :boolean,
      default: false,
      doc: "Whether to return pixels outside the image."
    ]
  ]

  @doc """
  Returns the pixel that shows a point of the camera's frame (metres).

  #{Situ.Options.docs(@schema)}

  Returns `{:error, :behind}` for points that are not in front of the camera, and `{:error, :outside}` for points
  outside the image.
  """
  @spec project(CameraIntrinsics.t(), Vector3.t(), keyword()) ::
          {:ok, pixel()} | {:error, :behind | :outside}
  def project(camera, point, opts \\ [])
  def project(_camera, {x, _y, _z}, _opts) when x <= 0, do: {:error, :behind}

  def project(%CameraIntrinsics{} = camera, {x, y, z}, opts) do
    opts = Situ.Options.validate!(opts, @schema)
    ideal = {-y / x, -z / x}

    with {:ok, {nx, ny}} <-
           if(opts[:distort], do: apply_distortion(camera, ideal), else: {:ok, ideal}),
         {{fx, fy}, {cx, cy}} = {camera.focal, camera.principal},
         {px, py} = pixel = {fx * nx + cx, fy * ny + cy} do
      inside? = px >= 0 and py >= 0 and px < camera.width and py < camera.height
      if inside? or opts[:outside], do: {:ok, pixel}, else: {:error, :outside}
    else
      :error -> {:error, :outside}
    end
  end

  defp apply_distortion(%{distorts?: true} = camera, point), do: {:ok, distort(camera, point)}
  defp apply_distortion(camera, point), do: undistort(camera, point)

  defp remove_distortion(%{distorts?: true} = camera, point), do: undistort(camera, point)
  defp remove_distortion(camera, point), do: {:ok, distort(camera, point)}

  @schema [
    undistort: [
      type: :boolean,
      default: true,
      doc: "Whether to remove the lens distortion."
    ],
    semantics: [
      type: {:in, [:plane, :point]},
      default: :plane,
      doc: "Whether `depth` is measured to the plane through the camera, or along the ray."
    ]
  ]

  @doc """
  Returns the point of the camera's frame that a pixel shows at a depth in metres.

  #{Situ.Options.docs(@schema)}

  Returns `{:error, :not_invertible}` if the distortion cannot be removed at this pixel.
  """
  @spec unproject(CameraIntrinsics.t(), pixel(), number(), keyword()) ::
          {:ok, Vector3.t()} | {:error, :not_invertible}
  def unproject(%CameraIntrinsics{} = camera, pixel, depth, opts \\ []) do
    opts = Situ.Options.validate!(opts, @schema)

    with {:ok, {nx, ny}} <- normalize_pixel(camera, pixel, opts[:undistort]) do
      d =
        if opts[:semantics] == :point,
          do: depth / :math.sqrt(nx * nx + ny * ny + 1),
          else: depth * 1.0

      {:ok, {d, -nx * d, -ny * d}}
    end
  end

  defp normalize_pixel(%{focal: {fx, fy}, principal: {cx, cy}} = camera, {px, py}, undistort?) do
    point = {(px - cx) / fx, (py - cy) / fy}

    if undistort? do
      with :error <- remove_distortion(camera, point), do: {:error, :not_invertible}
    else
      {:ok, point}
    end
  end

  @doc "Returns the ray of the camera's frame that a pixel shows."
  @spec pixel_ray(CameraIntrinsics.t(), pixel()) :: {:ok, Ray3.t()} | {:error, :not_invertible}
  def pixel_ray(%CameraIntrinsics{} = camera, pixel) do
    with {:ok, point} <- unproject(camera, pixel, 1.0),
         {:ok, ray} <- Ray3.new({0.0, 0.0, 0.0}, point),
         do: {:ok, ray}
  end

  @doc "Returns the pixel of a view that shows a point of the outer frame."
  @spec project_in_view(CameraView.t(), Vector3.t(), keyword()) ::
          {:ok, pixel()} | {:error, :behind | :outside}
  def project_in_view(%CameraView{} = view, point, opts \\ []),
    do: project(view.intrinsics, Pose.transform_point(Pose.invert(view.pose), point), opts)

  @doc "Returns the ray of the outer frame that a pixel of a view shows."
  @spec ray_in_view(CameraView.t(), pixel()) :: {:ok, Ray3.t()} | {:error, :not_invertible}
  def ray_in_view(%CameraView{} = view, pixel) do
    with {:ok, ray} <- pixel_ray(view.intrinsics, pixel),
         do: {:ok, Ray3.transform(ray, view.pose)}
  end
end
