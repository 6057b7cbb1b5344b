defmodule Situ.GeoPosition do
  @moduledoc """
  A place on the Earth, as a receiver of satellites tells it: latitude (-90..90) and longitude in degrees, altitude
  above the ellipsoid of WGS84 in metres (`nil` where it is not known), and how far off they may be (standard deviations
  to the east, to the north and up, in metres; `nil` where nobody says).

      iex> {:ok, place} = Situ.GeoPosition.new(46.0514, 14.506, 300.0)
      iex> {place.latitude, place.accuracy}
      {46.0514, nil}
      iex> {:error, error} = Situ.GeoPosition.new(91.0, 0.0)
      iex> error.what
      "there is no latitude of 91.0 degrees"

  `Situ.Geo` (situ_space) turns places into metres.
  """
  alias Situ.{Error, Vector3}

  @enforce_keys [:latitude, :longitude]
  defstruct [:latitude, :longitude, altitude: nil, accuracy: nil]

  @type t :: %__MODULE__{
          latitude: float(),
          longitude: float(),
          altitude: float() | nil,
          accuracy: Vector3.t() | nil
        }

  @doc "A checked place. Error: `:bad_place`."
  @spec new(number(), number(), number() | nil, Vector3.t() | nil) ::
          {:ok, t()} | {:error, Error.t()}
  def new(latitude, longitude, altitude \\ nil, accuracy \\ nil) do
    cond do
      not (is_number(latitude) and is_number(longitude) and
               (altitude == nil or is_number(altitude))) ->
        {:error,
         Error.new(
           :bad_place,
           "a place on the Earth is numbers, not #{inspect({latitude, longitude, altitude})}"
         )}

      abs(latitude) > 90 ->
        {:error,
         Error.new(:bad_place, "there is no latitude of #{latitude} degrees",
           fix: "latitude comes first, then longitude"
         )}

      true ->
        {:ok,
         %__MODULE__{
           latitude: latitude / 1,
           longitude: longitude / 1,
           altitude: altitude && altitude / 1,
           accuracy: accuracy
         }}
    end
  end
end
