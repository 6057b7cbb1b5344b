# The level of a sound, by a function of Nx over batches of buffers. Run it with: mix run examples/level.exs

defmodule Level do
  import Nx.Defn

  # {batch, frames, channels} of 16-bit samples -> the level of each buffer, from 0 to 1
  defn rms(samples) do
    samples |> Nx.divide(32_768) |> Nx.pow(2) |> Nx.mean(axes: [1, 2]) |> Nx.sqrt()
  end
end

format = Situ.AudioFormat.pcm(16_000, 1)

# 10 ms of a tone that becomes louder
buffer = fn n ->
  samples = for i <- 0..159, do: round(3_000 * n / 50 * :math.sin(2 * :math.pi() * i / 16))

  %Situ.AudioBuffer{
    format: format,
    data: for(s <- samples, into: <<>>, do: <<s::16-signed-little>>)
  }
end

{:ok, _report} =
  Situ.Pipeline.run(
    fn p ->
      p
      |> Situ.from_enumerable(Enum.map(1..200, buffer), every: Situ.Time.ms(10))
      |> Situ.Nx.map(&Level.rms/1, batch: 16)
      |> Situ.map(&Nx.to_number/1)
      |> Situ.filter(&(&1 > 0.25))
      |> Situ.first()
      |> Situ.each(fn level, message ->
        time = Situ.Time.format_duration(message.originating_time)

        IO.puts(
          "the tone is louder than 0.25 for the first time after #{time}: #{Float.round(level, 4)}"
        )
      end)
    end,
    pipeline: [replay: [interval: {0, :unbounded}]]
  )
