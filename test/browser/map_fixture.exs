defmodule MapFixture do
  @moduledoc false
  # One person walks a kilometre to the north and then one to the east. Another receiver emits
  # maps with errors.
  alias Situ.{GeoPoint, Image, ImageOps}
  alias Situ.Studio.History

  @t0 1_767_225_600_000_000_000
  @second 1_000_000_000

  def walk do
    h = History.new(seconds: 3_600, live: false)

    for s <- 0..100 do
      {north, east} = if s <= 50, do: {s / 50, 0.0}, else: {1.0, (s - 50) / 50}
      {:ok, place} = GeoPoint.new(46.0 + north * 0.009, 14.5 + east * 0.0129, accuracy: 50)
      put(h, "Walker", s, place)

      fix = %{"lat" => 46.004 - north * 0.001, "lon" => 14.506, "alt" => 300}
      put(h, "Dog", s, if(rem(s, 10) == 5, do: %{fix | "lat" => :nan}, else: fix))
    end

    h
  end

  defp put(h, stream, s, data), do: Fixture.put(h, stream, @t0 + s * @second, 0, data, s)

  # One image of a single color for every tile of the tested zooms.
  def tiles(work) do
    {:ok, png} = ImageOps.encode_png(Image.new_filled(256, 256, :rgb24, [200, 60, 160]))

    for z <- 12..17, {x, y} = middle(z), dx <- -3..3, dy <- -3..3 do
      folder = Path.join([work, "tiles", "#{z}", "#{x + dx}"])
      File.mkdir_p!(folder)
      File.write!(Path.join(folder, "#{y + dy}.png"), png.data)
    end

    Path.join(work, "tiles")
  end

  defp middle(z) do
    n = Bitwise.bsl(1, z)
    phi = 46.0045 * :math.pi() / 180
    y = (1 - :math.log(:math.tan(phi) + 1 / :math.cos(phi)) / :math.pi()) / 2
    {trunc((14.506 + 180) / 360 * n), trunc(y * n)}
  end
end
