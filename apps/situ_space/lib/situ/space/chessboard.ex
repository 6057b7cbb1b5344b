defmodule Situ.Space.Chessboard do
  @moduledoc """
  Finds chessboards in images and calibrates a camera from them: its intrinsics, and the pose of each board.

      boards = for picture <- pictures, {:ok, corners} <- [Chessboard.corners(picture, {9, 6})], do: corners
      {:ok, found} = Chessboard.calibrate(boards, {9, 6}, 0.025, {640, 480})
      found.intrinsics.focal

  A board is described by its inner corners: a board of 10 by 7 squares is `{9, 6}`. Choose an even and an odd number,
  because otherwise the board looks the same when rotated by half a turn. Ten boards that are tilted, near and far, and
  spread over the image determine the focal length to a tenth of a percent. Boards that all face the camera do not
  determine it.

  OpenCV finds corners with subpixel accuracy and calibrates by Zhang's method. It runs in a separate program
  (`Situ.Space.OpenCV`), which `bin/setup --with opencv` builds.
  """
  alias Situ.{CameraIntrinsics, Error, Image, ImageOps, Pose, Quaternion, Vector3}
  alias Situ.Space.OpenCV

  @type board :: {columns :: 3..50, rows :: 3..50}
  @type pixel :: {float(), float()}
  @typedoc """
  `error` is the root mean square of the reprojection error in pixels, of all corners and of each board. `pose` is the
  board's frame in the camera's. On the board, x runs along a row of corners and y along a column.
  """
  @type found :: %{
          intrinsics: CameraIntrinsics.t(),
          error: float(),
          boards: [%{pose: Pose.t(), error: float()}]
        }

  @corners [
    session: [
      type: {:optional, {:struct, OpenCV}},
      default: nil,
      doc: "A session of `Situ.Space.OpenCV.open/1`, to reuse for many images."
    ]
  ]

  @doc """
  Returns the pixels of the board's inner corners, row by row. Errors: `:no_board` in the image, `:no_opencv_port`.

  #{Situ.Options.docs(@corners)}
  """
  @spec corners(Image.t(), board(), keyword()) :: {:ok, [pixel()]} | {:error, Error.t()}
  def corners(%Image{} = picture, board, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @corners),
         {:ok, {columns, rows}} <- validate_board(board),
         {:ok, gray} <- encode_gray(picture) do
      case OpenCV.call_program(opts[:session], [1, columns, rows, gray]) do
        {:ok, bytes} ->
          {:ok, for(<<x::little-float-64, y::little-float-64 <- bytes>>, do: {x, y})}

        :not_found ->
          {:error, no_board(picture, {columns, rows})}

        error ->
          error
      end
    end
  end

  @doc false
  @spec encode_gray(Image.t()) :: {:ok, iodata()} | {:error, Error.t()}
  def encode_gray(picture) do
    with {:ok, %{width: width, height: height} = gray} <- ImageOps.convert(picture, :gray8) do
      rows =
        if gray.stride == width,
          do: binary_part(gray.data, 0, width * height),
          else: for(y <- 0..(height - 1), do: binary_part(gray.data, y * gray.stride, width))

      {:ok, [<<width::little-32, height::little-32>>, rows]}
    end
  end

  defp validate_board({columns, rows}) when columns in 3..50 and rows in 3..50,
    do: {:ok, {columns, rows}}

  defp validate_board(other) do
    {:error,
     Error.new(:bad_option, "invalid number of inner corners: #{inspect(other)}",
       fix: "give {columns, rows}, each 3 to 50"
     )}
  end

  defp no_board(picture, {columns, rows}) do
    Error.new(:no_board, "no board of #{columns} by #{rows} inner corners was found in the image",
      why:
        "the complete board must be visible with a bright margin (the image is #{picture.width}x#{picture.height})",
      fix:
        "count the inner corners again (squares minus one), and check for blur, shadows and fingers"
    )
  end

  @schema [distortion: Situ.Space.Calibration.distortion_option()] ++ @corners

  @doc """
  Calibrates the camera that saw these boards, each a list of corners from `corners/3`. `square` is the width of a
  square in metres, and `{width, height}` is the size of the images in pixels.

  #{Situ.Options.docs(@schema)}

  Errors: `:too_few` boards (at least three), `:not_found` if the boards do not determine the lens.
  """
  @spec calibrate([[pixel()]], board(), number(), {pos_integer(), pos_integer()}, keyword()) ::
          {:ok, found()} | {:error, Error.t()}
  def calibrate(boards, board, square, {width, height}, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, {columns, rows}} <- validate_board(board),
         :ok <- check_boards(boards, columns * rows, square) do
      kind = %{full: 0, none: 1, radial: 2}[opts[:distortion]]
      head = <<2, width::little-32, height::little-32, kind, length(boards)::little-32>>
      places = for y <- 0..(rows - 1), x <- 0..(columns - 1), do: {x * square, y * square}

      case OpenCV.call_program(opts[:session], [head | Enum.map(boards, &encode_view(&1, places))]) do
        {:ok, bytes} -> decode_result(bytes, {width, height})
        :not_found -> {:error, not_found("OpenCV found no solution")}
        {:error, %Error{code: :opencv_failed} = error} -> {:error, not_found(error.why)}
        error -> error
      end
    end
  end

  defp check_boards(boards, count, square) do
    cond do
      not (is_number(square) and square > 0) ->
        {:error,
         Error.new(
           :bad_option,
           "the square width must be a positive number, got #{inspect(square)} m"
         )}

      length(boards) < 3 ->
        {:error,
         Error.new(:too_few, "#{length(boards)} boards are too few to calibrate a lens",
           fix: "give at least three, better ten: tilted, near and far, spread over the image"
         )}

      board = Enum.find(boards, &(length(&1) != count)) ->
        {:error,
         Error.new(:bad_option, "a board of #{count} corners has #{length(board)} pixels",
           fix: "pass each board as returned by Situ.Space.Chessboard.corners/3"
         )}

      true ->
        check_pixels(boards)
    end
  end

  defp check_pixels(boards) do
    with true <- Enum.all?(boards, &Enum.all?(&1, fn p -> pixel?(p) end)),
         do: :ok,
         else: (_ -> not_pixels())
  end

  defp pixel?({x, y}), do: is_number(x) and is_number(y)
  defp pixel?(_other), do: false

  defp not_pixels,
    do:
      {:error,
       Error.new(:bad_option, "a board contains a value that is not a pixel",
         fix: "give {x, y} for each corner, with numbers"
       )}

  defp encode_view(pixels, places) do
    [
      <<length(pixels)::little-32>>,
      for {{x, y}, {u, v}} <- Enum.zip(places, pixels) do
        <<x::little-float-64, y::little-float-64, 0.0::little-float-64, u::little-float-64,
          v::little-float-64>>
      end
    ]
  end

  defp decode_result(bytes, {width, height}) do
    case for(<<value::little-float-64 <- bytes>>, do: value) do
      [error, fx, fy, cx, cy, k1, k2, p0, p1, _k3 | boards] when fx > 0 and fy > 0 ->
        options = [
          width: width,
          height: height,
          focal: {fx, fy},
          principal: {cx, cy},
          radial: [k1, k2],
          tangential: {p0, p1}
        ]

        with {:ok, intrinsics} <- CameraIntrinsics.new(options) do
          boards =
            for [e, a, b, c, x, y, z] <- Enum.chunk_every(boards, 7),
                do: %{error: e, pose: convert_pose({a, b, c}, {x, y, z})}

          {:ok, %{intrinsics: intrinsics, error: error, boards: boards}}
        end

      _ ->
        {:error, not_found("the best solution has values that are impossible for a lens")}
    end
  end

  defp not_found(why) do
    Error.new(:not_found, "no camera model fits these boards",
      why: why,
      fix: "tilt the boards and show them near and far; distortion: :none needs fewer boards"
    )
  end

  # OpenCV's camera looks along z, with x to the right and y down; ours looks along x, with y to the left and z up.
  @turn {0.5, -0.5, 0.5, -0.5}

  defp convert_pose(turn, {x, y, z}) do
    rotation =
      case Vector3.normalize(turn) do
        {:ok, axis} -> Quaternion.from_axis_angle(axis, Vector3.norm(turn))
        :error -> Quaternion.identity()
      end

    Pose.new({z, -x, -y}, Quaternion.multiply(@turn, rotation))
  end
end
