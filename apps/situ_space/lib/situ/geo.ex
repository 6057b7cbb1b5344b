defmodule Situ.Geo do
  @moduledoc """
  Converts positions on the Earth, given as latitude and longitude (degrees) and height above the ellipsoid (metres),
  to metres and back.

  The ellipsoid is WGS84 (NIMA TR8350.2, 2000). Local coordinates are x east, y north, z up of an origin, so that the
  track of a GPS receiver becomes points to draw, measure and join with the data of other sensors.

      iex> ljubljana = {46.0514, 14.5060, 300.0}
      iex> {east, north, up} = Situ.Geo.to_enu({46.0604, 14.5060, 300.0}, ljubljana)
      iex> {Float.round(east, 3), Float.round(north, 1), Float.round(up, 2)}
      {0.0, 1000.4, -0.08}
      iex> {lat, lon, height} = Situ.Geo.from_enu({0.0, 1000.4, -0.08}, ljubljana)
      iex> {Float.round(lat, 4), Float.round(lon, 4), Float.round(height, 1)}
      {46.0604, 14.506, 300.0}

  GPX files (tracks of GPS receivers) open like recordings: `Situ.Store.open("walk.gpx")`. The timestamped points of
  all tracks become the stream `Track` of `Situ.GeoPoint`s, sorted by time. Other content (way points, routes,
  extensions) is skipped, and `Situ.Store.info/1` reports the number of points without a time as `untimed`.
  """
  alias Situ.{Error, Quaternion, Vector3}

  @typedoc "Latitude -90..90 and longitude in degrees, height above the ellipsoid in metres."
  @type place :: {latitude :: number(), longitude :: number(), height :: number()}

  @a 6_378_137.0
  @f 1 / 298.257223563
  @b @a * (1 - @f)
  @e2 @f * (2 - @f)
  @steps 10

  @doc """
  Validates a position from a receiver or a file: three numbers, with latitude and longitude in range.

      iex> {:error, error} = Situ.Geo.validate_position(91, 14.5)
      iex> error.what
      "the latitude 91 is outside -90..90 degrees"
  """
  @spec validate_position(term(), term(), term()) :: {:ok, place()} | {:error, Error.t()}
  def validate_position(latitude, longitude, height \\ 0.0) do
    cond do
      not (is_number(latitude) and is_number(longitude) and is_number(height)) ->
        {:error,
         Error.new(
           :bad_place,
           "expected latitude, longitude and height as numbers, got #{inspect({latitude, longitude, height})}"
         )}

      abs(latitude) > 90 ->
        {:error,
         Error.new(:bad_place, "the latitude #{latitude} is outside -90..90 degrees",
           fix: "give the latitude first, then the longitude"
         )}

      abs(longitude) > 360 ->
        {:error, Error.new(:bad_place, "the longitude #{longitude} is outside -360..360 degrees")}

      true ->
        {:ok, {latitude * 1.0, longitude * 1.0, height * 1.0}}
    end
  end

  @doc """
  Returns a position in metres from the Earth's centre: x points to latitude and longitude 0, z to the north pole.
  """
  @spec to_ecef(place()) :: Vector3.t()
  def to_ecef({latitude, longitude, height}) do
    {sp, cp} = sin_cos(latitude)
    {sl, cl} = sin_cos(longitude)
    n = @a / :math.sqrt(1 - @e2 * sp * sp)
    {(n + height) * cp * cl, (n + height) * cp * sl, (n * (1 - @e2) + height) * sp}
  end

  @doc """
  Returns the position of a point given in metres from the Earth's centre, by iterating Bowring's formula until it
  converges. Source: B. R. Bowring, Transformation from spatial to geographical coordinates, 1976.
  """
  @spec from_ecef(Vector3.t()) :: place()
  def from_ecef({x, y, z}) do
    p = :math.sqrt(x * x + y * y)
    second = (@a * @a - @b * @b) / (@b * @b)
    phi = iterate_latitude({p, z}, :math.atan2(z * @a, p * @b), second, @steps)
    {s, c} = {:math.sin(phi), :math.cos(phi)}
    n = @a / :math.sqrt(1 - @e2 * s * s)
    height = p * c + z * s - @a * @a / n
    {to_degrees(phi), to_degrees(:math.atan2(y, x)), height}
  end

  defp iterate_latitude({p, z} = at, beta, second, steps) do
    {s, c} = {:math.sin(beta), :math.cos(beta)}
    phi = :math.atan2(z + second * @b * s * s * s, p - @e2 * @a * c * c * c)
    next = :math.atan2(@b * :math.sin(phi), @a * :math.cos(phi))

    if steps == 0 or abs(next - beta) < 1.0e-14,
      do: phi,
      else: iterate_latitude(at, next, second, steps - 1)
  end

  @doc "Returns a position in metres east, north and up of an origin."
  @spec to_enu(place(), place()) :: Vector3.t()
  def to_enu(place, origin) do
    moved = Vector3.subtract(to_ecef(place), to_ecef(origin))
    {east, north, up} = enu_axes(origin)

    {Vector3.dot_product(east, moved), Vector3.dot_product(north, moved),
     Vector3.dot_product(up, moved)}
  end

  @doc "Returns the position at the given metres east, north and up of an origin."
  @spec from_enu(Vector3.t(), place()) :: place()
  def from_enu({e, n, u}, origin) do
    {east, north, up} = enu_axes(origin)

    to_ecef(origin)
    |> Vector3.add(Vector3.scale(east, e))
    |> Vector3.add(Vector3.scale(north, n))
    |> Vector3.add(Vector3.scale(up, u))
    |> from_ecef()
  end

  @doc "Returns the rotation from the east, north, up axes at an origin to the axes of the Earth's centre."
  @spec enu_rotation(place()) :: Quaternion.t()
  def enu_rotation(origin) do
    {{ex, ey, ez}, {nx, ny, nz}, {ux, uy, uz}} = enu_axes(origin)
    {:ok, q} = Quaternion.from_matrix({{ex, nx, ux}, {ey, ny, uy}, {ez, nz, uz}})
    q
  end

  defp enu_axes({latitude, longitude, _}) do
    {sp, cp} = sin_cos(latitude)
    {sl, cl} = sin_cos(longitude)
    {{-sl, cl, 0.0}, {-sp * cl, -sp * sl, cp}, {cp * cl, cp * sl, sp}}
  end

  @doc "Returns the straight-line distance between two positions in metres; between distant ones it passes underground."
  @spec distance(place(), place()) :: float()
  def distance(a, b), do: Vector3.distance(to_ecef(a), to_ecef(b))

  defp sin_cos(degrees) do
    radians = degrees * :math.pi() / 180
    {:math.sin(radians), :math.cos(radians)}
  end

  defp to_degrees(radians), do: radians * 180 / :math.pi()
end
