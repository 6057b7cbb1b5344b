defmodule Situ.Bridge.Ros.CameraInfo do
  @moduledoc false
  # Converts `sensor_msgs/CameraInfo` to `Situ.CameraIntrinsics` and back: the pinhole model and the lens distortion.
  # The rest of the message (rectification, binning, region of interest) is dropped. Pure.
  alias Situ.{CameraIntrinsics, Error}

  @doc "Returns the intrinsics of a calibrated camera, or `:error` if the camera is not calibrated."
  @spec from_message(map()) :: {:ok, CameraIntrinsics.t()} | {:error, Error.t()} | :error
  def from_message(%{"width" => width, "height" => height} = m) do
    with [fx, _, cx, _, fy, cy, _, _, _] <- m["K"] || m["k"],
         true <- Enum.all?([fx, fy, cx, cy], &is_number/1) and width > 0 and height > 0,
         {:ok, radial, tangential, distorts?} <-
           parse_distortion(m["D"] || m["d"], m["distortion_model"]) do
      CameraIntrinsics.new(
        width: width,
        height: height,
        focal: {fx, fy},
        principal: {cx, cy},
        radial: radial,
        tangential: tangential,
        distorts?: distorts?
      )
    else
      _ -> :error
    end
  end

  def from_message(_), do: :error

  # The RealSense SDK uses the last two names. Its inverse model maps distorted to undistorted coordinates.
  @inverse "Inverse Brown Conrady"
  @models ["plumb_bob", "rational_polynomial", "", "Brown Conrady", @inverse]

  defp parse_distortion(d, model) when is_list(d) do
    case {Enum.all?(d, &is_number/1), d} do
      {true, [k1, k2, p1, p2 | rest]} when length(rest) <= 4 and model in @models ->
        {:ok, [k1, k2 | rest], {p1, p2}, model != @inverse}

      {true, d} when d == [] and model in @models ->
        {:ok, [], {0.0, 0.0}, true}

      # Without distortion, all models are equivalent.
      {true, [_ | _]} ->
        if Enum.all?(d, &(&1 == 0)), do: {:ok, [], {0.0, 0.0}, true}, else: :error

      _ ->
        :error
    end
  end

  defp parse_distortion(_d, _model), do: :error

  @doc "Renames the fields D, K, R and P to the upper or lower case that the encoding uses."
  @spec rename_matrices(map(), :ros1 | :cdr) :: map()
  def rename_matrices(message, encoding) do
    Enum.reduce(~w(d k r p), message, fn lower, message ->
      upper = String.upcase(lower)
      {from, to} = if encoding == :cdr, do: {upper, lower}, else: {lower, upper}

      case Map.pop(message, from) do
        {nil, message} -> message
        {value, message} -> Map.put(message, to, value)
      end
    end)
  end

  @doc "Converts intrinsics to the fields of a message. Raises `Situ.Error` (`:not_writable`) for an inverse model."
  @spec to_message(CameraIntrinsics.t()) :: map()
  def to_message(%CameraIntrinsics{distorts?: false, radial: radial, tangential: tangential} = c)
      when radial != {0.0, 0.0, 0.0, 0.0, 0.0, 0.0} or tangential != {0.0, 0.0} do
    raise Error.new(
            :not_writable,
            "a CameraInfo cannot describe the lens of the #{c.width}x#{c.height} camera",
            why:
              "its coefficients map distorted to undistorted coordinates, but ROS uses the opposite direction"
          )
  end

  def to_message(%CameraIntrinsics{focal: {fx, fy}, principal: {cx, cy}} = c) do
    {k1, k2, k3, k4, k5, k6} = c.radial
    {p1, p2} = c.tangential
    rational? = {k4, k5, k6} != {0.0, 0.0, 0.0}

    %{
      "width" => c.width,
      "height" => c.height,
      "distortion_model" => if(rational?, do: "rational_polynomial", else: "plumb_bob"),
      "D" => [k1, k2, p1, p2, k3] ++ if(rational?, do: [k4, k5, k6], else: []),
      "K" => [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
      "R" => [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
      "P" => [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    }
  end
end
