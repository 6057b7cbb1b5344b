defmodule Situ.Space.StereoDepth do
  @moduledoc """
  Computes depth images from the images of two cameras side by side.

      left
      |> Situ.join(right)
      |> Situ.via(Situ.Space.StereoDepth, focal: 994.98, baseline: 0.193)

  Input: pairs `{left, right}` of `Situ.Image`. They must be rectified: an object in a row of the left image is in the
  same row of the right one, further left by its disparity. Depth is focal length times the distance between the
  cameras, divided by disparity.

  OpenCV computes the disparities by semi-global matching (H. Hirschmueller, Stereo Processing by Semi-Global Matching
  and Mutual Information, 2008) in a separate program, which `bin/setup --with opencv` builds. Without it, the
  pipeline does not start (`:no_opencv_port`). Other errors are `:bad_image` for images that differ in size,
  `:bad_option` and `:opencv_failed`; they are errors of the component (`on_error:`).
  """

  @schema Situ.Space.Stereo.optics_schema() ++
            Keyword.delete(Situ.Space.Stereo.option_schema(), :session)

  use Situ.Component, inputs: [in: :any], outputs: [out: Situ.DepthImage], options: @schema

  alias Situ.Error
  alias Situ.Space.{OpenCV, Stereo}

  @impl true
  def init(opts) do
    with {:ok, _} <- OpenCV.fetch_program(), do: {:ok, %{opts: opts, session: nil}}
  end

  # A session ends with the process that opened it, so it is opened by the component's process.
  @impl true
  def handle_message(:in, message, context, %{session: nil} = state) do
    session = Error.unwrap!(OpenCV.open())
    handle_message(:in, message, context, %{state | session: session})
  end

  def handle_message(:in, %{data: {left, right}, originating_time: time}, _context, state) do
    case Stereo.compute_depth(left, right, [session: state.session] ++ state.opts) do
      {:ok, depth} -> {[{:out, time, depth}], state}
      {:error, error} -> raise error
    end
  end
end
