defmodule Situ.Space.Calibration do
  @moduledoc """
  Estimates a camera's intrinsics, and optionally its pose, from points with known positions and pixels.

  The estimate minimizes the reprojection error by nonlinear least squares, with the Levenberg-Marquardt method (D.
  Marquardt, An Algorithm for Least-Squares Estimation of Nonlinear Parameters, 1963) and central differences, like
  \\\\psi's `CalibrateCameraIntrinsics`.

      iex> camera = Situ.CameraIntrinsics.new!(width: 640, height: 480, focal: {520, 525}, radial: [0.05, -0.02])
      iex> points = for y <- -3..3, z <- -2..2, x <- [2.0, 3.0], do: {x, y * 0.25, z * 0.25}
      iex> seen = for p <- points, {:ok, pixel} <- [Situ.Space.Camera.project(camera, p)], do: {p, pixel}
      iex> {:ok, found} = Situ.Space.Calibration.calibrate_camera(seen, {640, 480}, distortion: :radial)
      iex> {fx, fy} = found.intrinsics.focal
      iex> {Float.round(fx, 3), Float.round(fy, 3), found.error < 1.0e-6}
      {520.0, 525.0, true}
  """

  @distortion [
    type: {:in, [:none, :radial, :full]},
    default: :full,
    doc: "The distortion to estimate: none, k1 and k2, or these and the tangential p0 and p1."
  ]
  @schema [
    distortion: @distortion,
    pose: [
      type: :boolean,
      default: false,
      doc:
        "Whether to estimate the camera's pose as well. The points may then be in any frame close to `start:`."
    ],
    start: [
      type: {:optional, {:struct, Situ.Pose}},
      default: nil,
      doc: "The initial pose of the search; by default the identity."
    ],
    rounds: [type: :pos_integer, default: 100, doc: "The maximum number of steps."]
  ]

  alias Situ.{CameraIntrinsics, Error, Pose, Quaternion, Vector3}
  alias Situ.Space.{Camera, LeastSquares}

  @doc false
  # Situ.Space.Chessboard offers the same option.
  def distortion_option, do: @distortion

  @type seen :: {Vector3.t(), Camera.pixel()}
  @typedoc """
  `error` is the root mean square of the reprojection error in pixels; `pose` is the camera's pose in the points' frame.
  """
  @type found :: %{intrinsics: CameraIntrinsics.t(), pose: Pose.t(), error: float()}

  @doc """
  Estimates a camera with images of `{width, height}` pixels from points (x forward, y left, z up) and their pixels.

  #{Situ.Options.docs(@schema)}

  Errors: `:too_few` points for the number of parameters, points that are not in front of the camera, and `:not_found`
  if the search does not converge: all points are on one plane at right angles to the view, or pixels belong to other
  points.
  """
  @spec calibrate_camera([seen()], {pos_integer(), pos_integer()}, keyword()) ::
          {:ok, found()} | {:error, Error.t()}
  def calibrate_camera(seen, {width, height} = size, opts \\ []) when is_list(seen) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         model = %{
           size: size,
           distortion: opts[:distortion],
           pose?: opts[:pose],
           from: opts[:start] || Pose.identity()
         },
         start = initial_parameters(model, max(width, height) * 1.0),
         :ok <- check_point_count(seen, length(start)),
         :ok <- check_points(seen),
         {:ok, {values, square}} <-
           LeastSquares.minimize(start, &point_residuals(&1, seen, model), opts[:rounds]) do
      error = :math.sqrt(square / length(seen))
      build_result(values, error, model)
    end
  end

  defp initial_parameters(%{size: {width, height}} = model, focal) do
    lens = [focal, focal, width / 2, height / 2]
    bends = %{none: [], radial: [0.0, 0.0], full: [0.0, 0.0, 0.0, 0.0]}[model.distortion]
    lens ++ bends ++ if(model.pose?, do: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], else: [])
  end

  defp check_point_count(seen, count) do
    if 2 * length(seen) >= count + 2,
      do: :ok,
      else:
        {:error,
         Error.new(
           :too_few,
           "#{length(seen)} points are too few for the #{count} parameters of this camera model",
           fix: "give more points, or estimate fewer parameters: distortion: :none, pose: false"
         )}
  end

  defp check_points(seen) do
    case Enum.find(seen, &(not match?({{x, y, z}, {u, v}} when is_number(x + y + z + u + v), &1))) do
      nil ->
        :ok

      bad ->
        {:error, Error.new(:bad_option, "expected a point with its pixel, got #{inspect(bad)}")}
    end
  rescue
    ArithmeticError ->
      {:error, Error.new(:bad_option, "a point or a pixel contains a value that is not a number")}
  end

  # Returns two errors for each point: to the right and down. Points that the camera cannot see get a large error.
  @far 1.0e4
  defp point_residuals(values, seen, model) do
    {camera, pose} = build_camera(values, model)
    into = Pose.invert(pose)

    Enum.flat_map(seen, fn {point, {u, v}} ->
      case project_point(camera, Pose.transform_point(into, point)) do
        {:ok, {x, y}} -> [x - u, y - v]
        :error -> [@far, @far]
      end
    end)
  end

  defp project_point(camera, {x, y, z}) when x > 1.0e-6 do
    {nx, ny} = Camera.distort(camera, {-y / x, -z / x})
    {{fx, fy}, {cx, cy}} = {camera.focal, camera.principal}
    {:ok, {fx * nx + cx, fy * ny + cy}}
  end

  defp project_point(_camera, _point), do: :error

  defp build_camera([fx, fy, cx, cy | more], %{size: {width, height}} = model) do
    {bends, pose} = Enum.split(more, %{none: 0, radial: 2, full: 4}[model.distortion])
    [k1, k2, p0, p1] = bends ++ List.duplicate(0.0, 4 - length(bends))

    camera = %CameraIntrinsics{
      width: width,
      height: height,
      focal: {fx, fy},
      principal: {cx, cy},
      radial: {k1, k2, 0.0, 0.0, 0.0, 0.0},
      tangential: {p0, p1}
    }

    {camera, offset_pose(model.from, pose)}
  end

  # Rotates the initial pose by a small rotation (axis times angle), then moves it.
  defp offset_pose(from, []), do: from

  defp offset_pose(from, [rx, ry, rz, x, y, z]) do
    turn =
      case Vector3.normalize({rx, ry, rz}) do
        {:ok, axis} -> Quaternion.from_axis_angle(axis, Vector3.norm({rx, ry, rz}))
        :error -> Quaternion.identity()
      end

    Pose.new(Vector3.add(from.position, {x, y, z}), Quaternion.multiply(from.rotation, turn))
  end

  # An error of a tenth of the image's width means that the search failed.
  defp build_result(values, error, %{size: {width, _}} = model) do
    {camera, pose} = build_camera(values, model)
    {{fx, fy}, {cx, cy}} = {camera.focal, camera.principal}
    {k1, k2, _, _, _, _} = camera.radial

    with true <- error < width / 10 and fx > 0 and fy > 0,
         {:ok, intrinsics} <-
           CameraIntrinsics.new(
             width: camera.width,
             height: camera.height,
             focal: {fx, fy},
             principal: {cx, cy},
             radial: [k1, k2],
             tangential: camera.tangential
           ) do
      {:ok, %{intrinsics: intrinsics, pose: pose, error: error}}
    else
      _ ->
        {:error,
         Error.new(:not_found, "no camera model fits these points and pixels",
           why: "the best model found has an error of #{Float.round(error, 1)} pixels",
           fix:
             "check that each pixel belongs to its point, give points at several depths, or set a better start:"
         )}
    end
  end
end
