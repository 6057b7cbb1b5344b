defmodule Situ.Bridge.Ros.Bag.RealSense do
  @moduledoc false
  # Bags that the RealSense SDK and its viewer record. Their topics are `/device_0/sensor_0/Depth_0/image/data` and the
  # like; depth is written as if it were a grey picture (`mono16`), and how many metres its unit has is the value of an
  # option of the sensor.
  alias Situ.{DepthImage, Image}

  @depth ~r"\A(/device_\d+/sensor_\d+)/Depth_\d+/image/data\z"
  # The unit of all cameras that were not told another one, metres.
  @unit 0.001

  @doc "Tracks with `:unit`, that of those with depth, `nil` of the others. `first` gives a track's first message."
  @spec tracks([map()], (map() -> term())) :: [map()]
  def tracks(tracks, first) do
    for track <- tracks do
      with "sensor_msgs/Image" <- track.type,
           [_, sensor] <- Regex.run(@depth, track.topic) do
        option = Enum.find(tracks, &(&1.topic == sensor <> "/option/Depth_Units/value"))
        unit = unit(option && first.(option))
        Map.merge(track, %{unit: unit, situ: {:or, [DepthImage, :map]}})
      else
        _ -> Map.put(track, :unit, nil)
      end
    end
  end

  # 32 bits hold no 0.001: seven digits of it are meant.
  defp unit(%{"data" => unit}), do: unit(unit)

  defp unit(unit) when is_float(unit) and unit > 1.0e-9 and unit < 1.0,
    do: Float.round(unit, 6 - floor(:math.log10(unit)))

  defp unit(_none), do: @unit

  @doc "A message's data: of a track with depth its grey picture as depth."
  @spec data(term(), float() | nil) :: term()
  def data(%Image{format: :gray16} = image, unit) when is_float(unit) do
    size = [width: image.width, height: image.height, stride: image.stride]

    case DepthImage.new([data: image.data, scale: unit] ++ size) do
      {:ok, depth} -> depth
      {:error, _} -> image
    end
  end

  def data(data, _unit), do: data
end
