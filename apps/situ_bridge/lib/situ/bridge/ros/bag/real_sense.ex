defmodule Situ.Bridge.Ros.Bag.RealSense do
  @moduledoc false
  # Reads bags recorded by the RealSense SDK and its viewer. Their topics are like
  # `/device_0/sensor_0/Depth_0/image/data`. Depth is stored as a gray image (`mono16`); the size of its unit in meters
  # is the value of an option of the sensor.
  alias Situ.{DepthImage, Image}

  @depth ~r"\A(/device_\d+/sensor_\d+)/Depth_\d+/image/data\z"
  # The default unit of all cameras, in meters.
  @unit 0.001

  @doc """
  Puts `:unit` into all tracks: the depth unit for depth images, and nil for other tracks. `first` returns the first
  message of a track.
  """
  @spec put_depth_units([map()], (map() -> term())) :: [map()]
  def put_depth_units(tracks, first) do
    for track <- tracks do
      with "sensor_msgs/Image" <- track.type,
           [_, sensor] <- Regex.run(@depth, track.topic) do
        option = Enum.find(tracks, &(&1.topic == sensor <> "/option/Depth_Units/value"))
        unit = depth_unit(option && first.(option))
        Map.merge(track, %{unit: unit, situ: {:or, [DepthImage, :map]}})
      else
        _ -> Map.put(track, :unit, nil)
      end
    end
  end

  # The option is a 32-bit float, which cannot represent 0.001 exactly, so it is rounded to seven digits.
  defp depth_unit(%{"data" => unit}), do: depth_unit(unit)

  defp depth_unit(unit) when is_float(unit) and unit > 1.0e-9 and unit < 1.0,
    do: Float.round(unit, 6 - floor(:math.log10(unit)))

  defp depth_unit(_none), do: @unit

  @doc "Converts the gray image of a depth track to a depth image. Returns other data unchanged."
  @spec convert_depth(term(), float() | nil) :: term()
  def convert_depth(%Image{format: :gray16} = image, unit) when is_float(unit) do
    size = [width: image.width, height: image.height, stride: image.stride]

    case DepthImage.new([data: image.data, scale: unit] ++ size) do
      {:ok, depth} -> depth
      {:error, _} -> image
    end
  end

  def convert_depth(data, _unit), do: data
end
