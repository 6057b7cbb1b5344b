defmodule Situ.Examples.ImuFusion do
  @moduledoc """
  Fuses sensors with different rates: an x-IMU3 measures acceleration 50 times, the magnetic field 20 times and the
  temperature once a second, at unrelated times.

  The acceleration is the primary stream. The magnetic field is interpolated to its times, and the temperature is the
  last measured value. Both joins are reproducible, so the fused stream does not depend on the order of arrival.

      {:ok, report} = Situ.Pipeline.run(Situ.Examples.ImuFusion, each: &IO.inspect/1)

  Each fused message is a map: `acceleration` (g), `field` (arbitrary units), `temperature` (degrees Celsius), and
  `heading`, the tilt-compensated direction of the magnetic field in degrees.
  """
  use Situ.Pipeline

  alias Situ.Reproducible

  @impl true
  def build(p, opts) do
    folder = opts[:folder] || Path.join(to_string(:code.priv_dir(:situ_examples)), "ximu3")
    read = fn name, columns -> read_sensor(p, Path.join(folder, name <> ".csv"), columns) end

    acceleration = read.("Inertial", 4..6)
    field = read.("Magnetometer", 1..3)
    temperature = read.("Temperature", 1..1)

    fused =
      acceleration
      |> Situ.join(field, Reproducible.adjacent(&interpolate_vectors/3))
      |> Situ.join(temperature, Reproducible.last(or_default: nil), flatten: false)
      |> Situ.map(&describe_sample/1)

    Situ.each(fused, opts[:each] || fn _ -> :ok end)
  end

  @doc """
  Returns the direction of the magnetic field relative to the device's x axis in degrees, tilt-compensated with the
  acceleration.
  """
  @spec magnetic_heading([float()], [float()]) :: float()
  def magnetic_heading([ax, ay, az], [mx, my, mz]) do
    roll = :math.atan2(ay, az)
    pitch = :math.atan2(-ax, ay * :math.sin(roll) + az * :math.cos(roll))
    {sr, cr, sp, cp} = {:math.sin(roll), :math.cos(roll), :math.sin(pitch), :math.cos(pitch)}
    level_y = mz * sr - my * cr
    level_x = mx * cp + my * sp * sr + mz * sp * cr
    :math.atan2(level_y, level_x) * 180 / :math.pi()
  end

  defp interpolate_vectors(a, b, ratio),
    do: Enum.zip_with(a, b, fn x, y -> x + (y - x) * ratio end)

  defp describe_sample({{acceleration, field}, temperature}) do
    %{
      acceleration: acceleration,
      field: field,
      temperature: temperature && hd(temperature),
      heading: magnetic_heading(acceleration, field)
    }
  end

  # The file has a header line and rows of numbers; the first column is the sensor's clock in microseconds.
  defp read_sensor(p, path, columns) do
    rows =
      path
      |> File.stream!()
      |> Stream.drop(1)
      |> Stream.map(fn line ->
        [time | _] = fields = line |> String.trim() |> String.split(",")

        {Situ.Time.us(String.to_integer(time)),
         Enum.map(Enum.slice(fields, columns), &parse_float/1)}
      end)

    Situ.from_enumerable(p, rows, type: {:list, :float})
  end

  defp parse_float(text), do: text |> Float.parse() |> elem(0)
end
