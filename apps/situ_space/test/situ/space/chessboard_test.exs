defmodule Situ.Space.ChessboardTest do
  use ExUnit.Case, async: true
  alias Situ.{CameraIntrinsics, Error, Image, Pose, Quaternion, Vector3}
  alias Situ.Space.{Camera, Chessboard}

  @board {7, 5}
  @square 0.03

  # A board in the camera's frame, with x along its rows and y along its columns, rotated about three axes.
  defp pose(yaw, pitch, roll, place) do
    facing = {0.5, -0.5, 0.5, -0.5}
    Pose.new(place, Quaternion.multiply(Quaternion.from_euler(yaw, pitch, roll), facing))
  end

  defp places do
    {columns, rows} = @board
    for y <- 0..(rows - 1), x <- 0..(columns - 1), do: {x * @square, y * @square, 0.0}
  end

  defp pixels(camera, pose) do
    for place <- places() do
      {:ok, pixel} = Camera.project(camera, Pose.transform_point(pose, place))
      pixel
    end
  end

  # The board as that camera sees it: black and white squares with a white margin on gray, with nine rays per pixel.
  defp picture(%{width: width, height: height} = camera, pose) do
    inverse = Pose.invert(pose)
    eye = inverse.position
    {{fx, fy}, {cx, cy}} = {camera.focal, camera.principal}

    data =
      for v <- 0..(height - 1), u <- 0..(width - 1), into: <<>> do
        rays =
          for i <- -1..1, j <- -1..1 do
            ray = {1.0, -(u + i / 3 - cx) / fx, -(v + j / 3 - cy) / fy}
            shade(eye, Quaternion.rotate_vector(inverse.rotation, ray))
          end

        <<div(Enum.sum(rays), 9)>>
      end

    Image.new!(width: width, height: height, format: :gray8, data: data)
  end

  defp shade({x, y, z}, {dx, dy, dz}) do
    t = -z / dz
    {columns, rows} = @board
    {a, b} = {Float.floor((x + t * dx) / @square), Float.floor((y + t * dy) / @square)}

    cond do
      a < -2 or b < -2 or a > columns or b > rows -> 128
      a < -1 or b < -1 or a > columns - 1 or b > rows - 1 -> 230
      rem(trunc(a + b) + 100, 2) == 0 -> 20
      true -> 230
    end
  end

  @tag :opencv
  test "finds corners where a camera sees them, to a fraction of a pixel" do
    camera = CameraIntrinsics.new!(width: 240, height: 180, focal: {300, 300})
    pose = pose(0.4, 0.3, 0.1, {0.45, 0.07, 0.07})
    truth = pixels(camera, pose)
    assert {:ok, corners} = Chessboard.corners(picture(camera, pose), @board)

    # This board looks the same from either end, so both orders of the corners are correct.
    off = fn list ->
      squares = Enum.zip_with(list, truth, fn {x, y}, {u, v} -> (x - u) ** 2 + (y - v) ** 2 end)
      :math.sqrt(Enum.sum(squares) / length(squares))
    end

    # The image itself is rendered with nine rays per pixel.
    assert min(off.(corners), off.(Enum.reverse(corners))) < 0.2
  end

  @tag :opencv
  test "recovers the lens and the boards' poses" do
    camera =
      CameraIntrinsics.new!(
        width: 640,
        height: 480,
        focal: {520, 530},
        principal: {310, 250},
        radial: [0.08, -0.1],
        tangential: {0.002, -0.001}
      )

    poses =
      for {yaw, pitch, roll, x} <- [
            {0.4, 0.0, 0.0, 0.5},
            {-0.4, 0.2, 0.1, 0.6},
            {0.0, 0.5, -0.3, 0.4},
            {0.2, -0.4, 0.6, 0.7},
            {-0.3, -0.3, 0.0, 0.45}
          ],
          do: pose(yaw, pitch, roll, {x, 0.1, 0.06})

    boards = Enum.map(poses, &pixels(camera, &1))
    assert {:ok, found} = Chessboard.calibrate(boards, @board, @square, {640, 480})
    assert found.error < 1.0e-3
    {fx, fy} = found.intrinsics.focal
    assert_in_delta fx, 520, 0.1
    assert_in_delta fy, 530, 0.1
    {k1, k2, _, _, _, _} = found.intrinsics.radial
    assert_in_delta k1, 0.08, 1.0e-3
    assert_in_delta k2, -0.1, 1.0e-2
    {p0, p1} = found.intrinsics.tangential
    assert_in_delta p0, 0.002, 1.0e-4
    assert_in_delta p1, -0.001, 1.0e-4

    for {%{pose: seen, error: error}, pose} <- Enum.zip(found.boards, poses) do
      assert error < 1.0e-2
      assert Vector3.norm(Vector3.subtract(seen.position, pose.position)) < 1.0e-3
      assert Quaternion.angle_between(seen.rotation, pose.rotation) < 1.0e-3
    end
  end

  @tag :opencv
  test "no board, too few boards and boards of other sizes are errors" do
    camera = CameraIntrinsics.new!(width: 640, height: 480, focal: {520, 530})

    noise =
      Image.new!(width: 64, height: 64, format: :gray8, data: :crypto.strong_rand_bytes(4096))

    assert {:error, %Error{code: :no_board, fix: "count" <> _}} =
             Chessboard.corners(noise, @board)

    board = pixels(camera, pose(0.4, 0.1, 0.0, {0.5, 0.1, 0.06}))
    size = {640, 480}

    assert {:error, %Error{code: :too_few}} = Chessboard.calibrate([board], @board, @square, size)

    assert {:error, %Error{code: :bad_option, what: "a board of 35 corners has 34 pixels"}} =
             Chessboard.calibrate([board, board, tl(board)], @board, @square, size)

    assert {:error, %Error{code: :bad_option}} =
             Chessboard.calibrate([board, board, [nil | tl(board)]], @board, @square, size)

    assert {:error, %Error{code: :bad_option}} =
             Chessboard.calibrate([board, board, board], @board, 0, size)

    assert {:error, %Error{code: :bad_option}} = Chessboard.corners(noise, {2, 900})

    # All pixels have the same position.
    point = List.duplicate({5.0, 5.0}, 35)

    assert {:error, %Error{code: :not_found, fix: "tilt" <> _}} =
             Chessboard.calibrate([point, point, point], @board, @square, size)
  end
end
