defmodule SensorFixture do
  # Pipelines whose camera and microphone are a page. They count the messages in a file that the
  # tests read.
  alias Situ.{AudioBuffer, EncodedImage, ImageOps, Time}
  alias Situ.Studio.Sensor

  def start(path) do
    {:ok, counts} = Agent.start(fn -> %{pictures: 0, seconds: 0.0, loudest: 0} end)

    {:ok, _} =
      Situ.Pipeline.start(
        fn p ->
          sensor = Sensor.open(p, page: "browser")
          Situ.each(sensor.video, &note(counts, path, look(&1, &2)))
          Situ.each(sensor.audio, fn buffer -> Agent.update(counts, &hear(&1, buffer)) end)
          Sensor.Speaker.play(sensor.audio, page: "browser")
        end,
        pipeline: [name: "Browser"]
      )

    {:ok, _} =
      Situ.Pipeline.start(
        fn p ->
          stuck = fn _ -> Process.sleep(:infinity) end
          sensor = Sensor.open(p, page: "stuck", buffer: 4)
          Situ.each(sensor.video, stuck, async: true, policy: Situ.Delivery.throttle(2))
        end,
        pipeline: [name: "Stuck"]
      )
  end

  defp look(%EncodedImage{} = jpeg, message) do
    {:ok, image} = ImageOps.parse(jpeg.data)
    {:ok, rgb} = ImageOps.convert(image, :rgb24)
    # A row in the middle shows the color.
    row = binary_part(rgb.data, div(rgb.height, 2) * rgb.stride, rgb.width * 3)
    pixels = for <<r, g, b <- row>>, do: {r, g, b}
    mean = fn i -> pixels |> Enum.map(&elem(&1, i)) |> Enum.sum() |> div(length(pixels)) end
    late = (Time.now() - message.originating_time) / 1.0e6

    %{
      width: rgb.width,
      height: rgb.height,
      red: mean.(0),
      green: mean.(1),
      blue: mean.(2),
      late_ms: late
    }
  end

  defp note(counts, path, seen) do
    now =
      Agent.get_and_update(counts, fn c ->
        {Map.merge(c, seen), %{c | pictures: c.pictures + 1}}
      end)

    File.write!(path <> ".new", Situ.JSON.encode(now))
    File.rename!(path <> ".new", path)
  end

  defp hear(counts, buffer) do
    loudest = buffer |> AudioBuffer.to_samples() |> Enum.map(&abs/1) |> Enum.max()
    seconds = counts.seconds + AudioBuffer.duration_ns(buffer) / 1.0e9
    %{counts | seconds: seconds, loudest: max(counts.loudest, loudest)}
  end
end
