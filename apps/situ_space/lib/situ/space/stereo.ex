defmodule Situ.Space.Stereo do
  @moduledoc false
  # Computes depth from a pair of rectified images, with OpenCV's semi-global matching. `Situ.Space.StereoDepth`
  # documents the method and does the same for streams.

  @schema [
    least: [
      type: {:range, -1_024, 1_024},
      default: 0,
      doc: "The smallest disparity to search for, pixels."
    ],
    count: [
      type: {:range, 16, 512},
      default: 64,
      doc: "The number of disparities to search, a multiple of 16. Nearer objects are not found."
    ],
    block: [
      type: {:in, [1, 3, 5, 7, 9, 11]},
      default: 5,
      doc: "The width of the blocks to compare, pixels."
    ],
    whole: [
      type: :boolean,
      default: false,
      doc:
        "Search along eight directions instead of five: better, slower, and needs 9 bytes per pixel and disparity."
    ],
    fill: [
      type: :boolean,
      default: false,
      doc:
        "Fill pixels without a disparity (most are occluded) with the smaller disparity of their neighbours in the row."
    ],
    session: [
      type: {:optional, {:struct, Situ.Space.OpenCV}},
      default: nil,
      doc: "A session of `Situ.Space.OpenCV.open/1`, to reuse for many images."
    ]
  ]

  alias Situ.{DepthImage, Error, Image}
  alias Situ.Space.{Chessboard, OpenCV}

  @doc "Returns the options, for modules that also offer them."
  @spec option_schema() :: keyword()
  def option_schema, do: @schema

  @doc """
  Returns the disparity of each pixel of the left image, row by row, as 16-bit little-endian numbers in sixteenths of a
  pixel. Values below `least` mean that the disparity is unknown.
  """
  @spec compute_disparity(Image.t(), Image.t(), keyword()) ::
          {:ok, binary()} | {:error, Error.t()}
  def compute_disparity(%Image{} = left, %Image{} = right, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         :ok <- check_same_size(left, right),
         :ok <- check_count(opts[:count], left.width),
         {:ok, a} <- Chessboard.encode_gray(left),
         {:ok, b} <- Chessboard.encode_gray(right) do
      flags = for key <- [:whole, :fill], into: <<>>, do: if(opts[key], do: <<1>>, else: <<0>>)

      head =
        <<3, opts[:least]::little-32, opts[:count]::little-32, opts[:block]::little-32,
          flags::binary>>

      OpenCV.call_program(opts[:session], [head, a, b])
    end
  end

  @optics [
    focal: [
      type: :number,
      required: true,
      doc: "The focal length of the rectified images, pixels."
    ],
    baseline: [type: :number, required: true, doc: "The distance between the cameras, m."],
    offset: [
      type: :number,
      default: 0.0,
      doc: "The horizontal offset of the right camera's principal point, to the right, pixels."
    ],
    scale: [type: :number, default: 0.001, doc: "Metres per unit of the depth image."]
  ]

  @doc "Returns the options that `compute_depth/3` takes in addition to the options of `compute_disparity/3`."
  @spec optics_schema() :: keyword()
  def optics_schema, do: @optics

  @doc """
  Returns the depth of each pixel of the left image.

  #{Situ.Options.docs(@optics)}
  """
  @spec compute_depth(Image.t(), Image.t(), keyword()) ::
          {:ok, DepthImage.t()} | {:error, Error.t()}
  def compute_depth(%Image{} = left, %Image{} = right, opts) do
    {optics, search} = Keyword.split(opts, Keyword.keys(@optics))

    with {:ok, optics} <- Situ.Options.validate(optics, @optics),
         {:ok, disparities} <- compute_disparity(left, right, search) do
      least = 16 * Keyword.get(search, :least, 0)
      unit = 16 * optics[:focal] * optics[:baseline] / optics[:scale]

      data =
        for <<d::little-signed-16 <- disparities>>,
          into: <<>>,
          do: depth_pixel(d, least, unit, 16 * optics[:offset])

      DepthImage.new(width: left.width, height: left.height, data: data, scale: optics[:scale])
    end
  end

  defp depth_pixel(d, least, unit, offset) when d >= least and d + offset > 0 do
    case round(unit / (d + offset)) do
      value when value <= 65_535 -> <<value::little-16>>
      _ -> <<0, 0>>
    end
  end

  defp depth_pixel(_d, _least, _unit, _offset), do: <<0, 0>>

  defp check_same_size(%{width: w, height: h}, %{width: w, height: h}), do: :ok

  defp check_same_size(left, right) do
    {:error,
     Error.new(:bad_image, "the two images differ in size",
       why:
         "one has #{left.width}x#{left.height} pixels, the other #{right.width}x#{right.height}",
       fix: "crop or resize one, and rectify both"
     )}
  end

  defp check_count(count, width) when rem(count, 16) == 0 and count < width, do: :ok

  defp check_count(count, width) do
    {:error,
     Error.new(
       :bad_option,
       "invalid count: #{count} disparities in images #{width} pixels wide",
       fix: "give a multiple of 16 below the width"
     )}
  end
end
