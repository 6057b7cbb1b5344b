defmodule Situ.Space.StereoDepth do
  @moduledoc """
  Computes depth images from a stream of pairs of rectified images with `Situ.Space.Stereo`, in one `opencv_port`.

      left
      |> Situ.join(right)
      |> Situ.via(Situ.Space.StereoDepth, focal: 994.98, baseline: 0.193)

  Input: pairs `{left, right}` of `Situ.Image`. An invalid pair is an error of the component (`on_error:`).
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
