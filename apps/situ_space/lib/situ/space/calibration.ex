defmodule Situ.Space.Calibration do
  @distortion [
    type: {:in, [:none, :radial, :full]},
    default: :full,
    doc: "Which of the lens is found: nothing, k1 and k2, or these and the tangential p0 and p1."
  ]
  @schema [
    distortion: @distortion,
    pose: [
      type: :boolean,
      default: false,
      doc:
        "Whether the camera's pose is found, too: then points are given in any frame, near `start:`."
    ],
    start: [
      type: {:optional, {:struct, Situ.Pose}},
      default: nil,
      doc: "Where to begin the search for the pose; by default the identity."
    ],
    rounds: [type: :pos_integer, default: 100, doc: "Steps at most."]
  ]

  @moduledoc """
  A camera's lens, and where it stands, from points whose places and pixels are both known.

  Nonlinear least squares over the distances between where pixels are and where the model puts them, by
  Levenberg-Marquardt (D. Marquardt, An Algorithm for Least-Squares Estimation of Nonlinear Parameters, 1963) with
  central differences, as \\\\psi's `CalibrateCameraIntrinsics` does it.

      iex> camera = Situ.CameraIntrinsics.new!(width: 640, height: 480, focal: {520, 525}, radial: [0.05, -0.02])
      iex> points = for y <- -3..3, z <- -2..2, x <- [2.0, 3.0], do: {x, y * 0.25, z * 0.25}
      iex> seen = for p <- points, {:ok, pixel} <- [Situ.Space.Camera.project(camera, p)], do: {p, pixel}
      iex> {:ok, found} = Situ.Space.Calibration.camera(seen, {640, 480}, distortion: :radial)
      iex> {fx, fy} = found.intrinsics.focal
      iex> {Float.round(fx, 3), Float.round(fy, 3), found.error < 1.0e-6}
      {520.0, 525.0, true}
  """
  alias Situ.{CameraIntrinsics, Error, Pose, Quaternion, Vector3}
  alias Situ.Space.{Camera, LeastSquares}

  @doc false
  # The option, for other ways to the same camera.
  def distortion, do: @distortion

  @type seen :: {Vector3.t(), Camera.pixel()}
  @typedoc "`error` is the root of the mean squared distance, in pixels; `pose` is the camera's in the points' frame."
  @type found :: %{intrinsics: CameraIntrinsics.t(), pose: Pose.t(), error: float()}

  @doc """
  The camera of a picture of so many pixels that shows these points (x forward, y left, z up) at these pixels.

  #{Situ.Options.docs(@schema)}

  Errors: `:too_few` points for what is asked for, points behind the camera, and `:not_found` where the search ends far
  from any answer: points on one plane at right angles to the view, or pixels that belong to other points.
  """
  @spec camera([seen()], {pos_integer(), pos_integer()}, keyword()) ::
          {:ok, found()} | {:error, Error.t()}
  def camera(seen, {width, height} = size, opts \\ []) when is_list(seen) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         model = %{
           size: size,
           distortion: opts[:distortion],
           pose?: opts[:pose],
           from: opts[:start] || Pose.identity()
         },
         start = start(model, max(width, height) * 1.0),
         :ok <- enough(seen, length(start)),
         :ok <- numbers(seen),
         {:ok, {values, square}} <-
           LeastSquares.minimize(start, &residuals(&1, seen, model), opts[:rounds]) do
      error = :math.sqrt(square / length(seen))
      answer(values, error, model)
    end
  end

  defp start(%{size: {width, height}} = model, focal) do
    lens = [focal, focal, width / 2, height / 2]
    bends = %{none: [], radial: [0.0, 0.0], full: [0.0, 0.0, 0.0, 0.0]}[model.distortion]
    lens ++ bends ++ if(model.pose?, do: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], else: [])
  end

  defp enough(seen, count) do
    if 2 * length(seen) >= count + 2,
      do: :ok,
      else:
        {:error,
         Error.new(
           :too_few,
           "#{length(seen)} points are too few for #{count} parameters of a camera",
           fix: "give more points, or fewer parameters: distortion: :none, pose: false"
         )}
  end

  defp numbers(seen) do
    case Enum.find(seen, &(not match?({{x, y, z}, {u, v}} when is_number(x + y + z + u + v), &1))) do
      nil -> :ok
      bad -> {:error, Error.new(:bad_option, "not a point with its pixel: #{inspect(bad)}")}
    end
  rescue
    ArithmeticError -> {:error, Error.new(:bad_option, "a point or a pixel is no number")}
  end

  # Two numbers for each point: how far off it is to the right and down. Who is not in front of the camera is far off.
  @far 1.0e4
  defp residuals(values, seen, model) do
    {camera, pose} = build(values, model)
    into = Pose.invert(pose)

    Enum.flat_map(seen, fn {point, {u, v}} ->
      case project(camera, Pose.transform(into, point)) do
        {:ok, {x, y}} -> [x - u, y - v]
        :error -> [@far, @far]
      end
    end)
  end

  defp project(camera, {x, y, z}) when x > 1.0e-6 do
    {nx, ny} = Camera.distort(camera, {-y / x, -z / x})
    {{fx, fy}, {cx, cy}} = {camera.focal, camera.principal}
    {:ok, {fx * nx + cx, fy * ny + cy}}
  end

  defp project(_camera, _point), do: :error

  defp build([fx, fy, cx, cy | more], %{size: {width, height}} = model) do
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

    {camera, moved(model.from, pose)}
  end

  # The pose to begin with, turned by a small rotation (axis times angle) and moved.
  defp moved(from, []), do: from

  defp moved(from, [rx, ry, rz, x, y, z]) do
    turn =
      case Vector3.normalize({rx, ry, rz}) do
        {:ok, axis} -> Quaternion.from_axis_angle(axis, Vector3.norm({rx, ry, rz}))
        :error -> Quaternion.identity()
      end

    Pose.new(Vector3.add(from.position, {x, y, z}), Quaternion.multiply(from.rotation, turn))
  end

  # Off by a tenth of the picture is no answer.
  defp answer(values, error, %{size: {width, _}} = model) do
    {camera, pose} = build(values, model)
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
         Error.new(:not_found, "no camera shows these points at these pixels",
           why: "the best one found is off by #{Float.round(error, 1)} pixels",
           fix:
             "look for pixels that belong to other points, give points at several depths, or a better start:"
         )}
    end
  end
end
