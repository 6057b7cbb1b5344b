defmodule Situ.GeoPoint do
  @moduledoc """
  A position on the Earth (WGS84), as reported by GPS receivers. Latitude (-90..90) and longitude (-180..180) are in
  degrees, and the optional height above the ellipsoid is in metres. The optional accuracy is a standard deviation in
  metres: one horizontal value, or `{east, north, up}`.

      iex> {:ok, here} = Situ.GeoPoint.new(46.0514, 14.5060, accuracy: 4.5)
      iex> {here.latitude, here.height, here.accuracy}
      {46.0514, nil, 4.5}
      iex> {:error, error} = Situ.GeoPoint.new(91, 14.5)
      iex> error.what
      "invalid latitude 91: it must be between -90 and 90 degrees"
  """
  alias Situ.{Error, Vector3}

  @enforce_keys [:latitude, :longitude]
  defstruct [:latitude, :longitude, :height, :accuracy]

  @type t :: %__MODULE__{
          latitude: float(),
          longitude: float(),
          height: float() | nil,
          accuracy: float() | Vector3.t() | nil
        }

  @doc "Builds a position. Options: `height:` and `accuracy:`, in metres. Error: `:bad_place`."
  @spec new(term(), term(), height: number() | nil, accuracy: number() | Vector3.t() | nil) ::
          {:ok, t()} | {:error, Error.t()}
  def new(latitude, longitude, opts \\ []) do
    cond do
      not (is_number(latitude) and is_number(longitude)) ->
        point_error(
          "latitude and longitude must be numbers, got: #{inspect({latitude, longitude})}"
        )

      abs(latitude) > 90 ->
        point_error(
          "invalid latitude #{latitude}: it must be between -90 and 90 degrees",
          "pass latitude first, then longitude"
        )

      abs(longitude) > 360 ->
        point_error("invalid longitude #{longitude}: it must be between -360 and 360 degrees")

      true ->
        {:ok,
         %__MODULE__{
           latitude: latitude / 1,
           longitude: wrap_longitude(longitude / 1),
           height: to_metres(opts[:height]),
           accuracy: accuracy_of(opts[:accuracy])
         }}
    end
  end

  defp wrap_longitude(longitude) when longitude > 180, do: longitude - 360
  defp wrap_longitude(longitude) when longitude < -180, do: longitude + 360
  defp wrap_longitude(longitude), do: longitude

  defp to_metres(x) when is_number(x), do: x / 1
  defp to_metres(_), do: nil

  defp accuracy_of({east, north, up})
       when is_number(east) and is_number(north) and is_number(up),
       do: {east / 1, north / 1, up / 1}

  defp accuracy_of(accuracy), do: to_metres(accuracy)

  @doc """
  Returns the horizontal accuracy in metres, the larger of east and north, or `nil` if it is unknown.

      iex> {:ok, place} = Situ.GeoPoint.new(46.0, 14.5, accuracy: {1.0, 2.0, 5.0})
      iex> Situ.GeoPoint.horizontal_accuracy(place)
      2.0
  """
  @spec horizontal_accuracy(t()) :: float() | nil
  def horizontal_accuracy(%__MODULE__{accuracy: {east, north, _up}}), do: max(east, north)
  def horizontal_accuracy(%__MODULE__{accuracy: accuracy}), do: accuracy

  defp point_error(what, fix \\ nil), do: {:error, Error.new(:bad_place, what, fix: fix)}

  @names [
    {["latitude", "lat"], ["longitude", "lon", "lng", "long"]}
  ]
  @heights ["height", "altitude", "alt", "ele", "elevation"]
  @accuracies ["accuracy", "horizontal_accuracy", "hacc"]

  @doc """
  Reads a position from message data. Accepts a `Situ.GeoPoint`, a map with common names for latitude and longitude
  (`lat`, `lon`, ...), or a ROS `NavSatFix`, whose covariance gives the accuracy. Returns `:error` for other data.

      iex> {:ok, place} = Situ.GeoPoint.from_data(%{"lat" => 46.0, "lng" => 14.5, "altitude" => 300})
      iex> {place.longitude, place.height}
      {14.5, 300.0}
      iex> Situ.GeoPoint.from_data(%{"lat" => :nan, "lon" => 0})
      :error
      iex> Situ.GeoPoint.from_data({46.0, 14.5})
      :error
  """
  @spec from_data(term()) :: {:ok, t()} | :error
  def from_data(%__MODULE__{latitude: latitude, longitude: longitude} = place) do
    case new(latitude, longitude, height: place.height, accuracy: place.accuracy) do
      {:ok, place} -> {:ok, place}
      {:error, _} -> :error
    end
  end

  def from_data(%_{}), do: :error

  def from_data(%{} = map) when map_size(map) < 100 do
    map =
      for {key, value} <- map,
          is_atom(key) or is_binary(key),
          into: %{},
          do: {normalize_key(key), value}

    Enum.find_value(@names, :error, fn {latitudes, longitudes} ->
      with latitude when latitude != nil <- first_value(map, latitudes),
           longitude when longitude != nil <- first_value(map, longitudes),
           opts = [height: first_value(map, @heights), accuracy: find_accuracy(map)],
           {:ok, place} <- new(latitude, longitude, opts) do
        {:ok, place}
      else
        _ -> nil
      end
    end)
  end

  def from_data(_), do: :error

  defp normalize_key(key), do: key |> to_string() |> String.downcase()

  defp first_value(map, names), do: Enum.find_value(names, &map[&1])

  # Uses the larger of the east and north standard deviations.
  defp find_accuracy(%{"position_covariance" => [east, _, _, _, north | _]})
       when is_number(east) and is_number(north) and (east > 0 or north > 0),
       do: :math.sqrt(max(east, north))

  defp find_accuracy(map), do: first_value(map, @accuracies)
end
