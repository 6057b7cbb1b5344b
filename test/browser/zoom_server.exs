# A studio with an hour of numbers, booleans and audio, for zoom.mjs: FOLDER. 570 MB, half a
# minute.
alias Situ.{AudioBuffer, AudioFormat, Message}
alias Situ.Store.Writer

[folder | _] = System.argv()
count = 10_000_000
t0 = 1_700_000_000_000_000_000
hour = 3_600_000_000_000
step = div(hour, count)

message = fn data, time, i ->
  %Message{data: data, originating_time: time, creation_time: time, sequence_id: i}
end

{:ok, writer} = Writer.create("long", folder)
{:ok, level} = Writer.stream(writer, "Level", type: :float)
{:ok, speaking} = Writer.stream(writer, "Speaking", type: :boolean)
{:ok, mic} = Writer.stream(writer, "Mic", type: AudioBuffer)

{level, speaking} =
  0..(count - 1)
  |> Stream.chunk_every(20_000)
  |> Enum.reduce({level, speaking}, fn part, {level, speaking} ->
    at = &(t0 + &1 * step)
    wave = &(:math.sin(&1 / 50_000) + :rand.uniform() / 4)
    talks? = &(rem(div(&1, 37 + rem(div(&1, 100_000), 50)), 2) == 0)
    {:ok, level} = Writer.append(level, for(i <- part, do: message.(wave.(i), at.(i), i)))
    {:ok, speaking} = Writer.append(speaking, for(i <- part, do: message.(talks?.(i), at.(i), i)))
    {level, speaking}
  end)

# Each is a tenth of a second from a random position in a second of noise with a tone.
format = %AudioFormat{rate: 48_000, channels: 1, sample: :s16}

second =
  for i <- 0..47_999,
      into: <<>>,
      do: <<round(8_000 * :math.sin(i / 20) + 2_000 * :rand.uniform())::little-signed-16>>

mic =
  for i <- 0..35_999, reduce: mic do
    mic ->
      data = binary_part(second, 2 * rem(i * 7_919, 43_000), 9_600)
      sound = AudioBuffer.new!(format: format, data: data)
      {:ok, mic} = Writer.append(mic, [message.(sound, t0 + (i + 1) * 100_000_000, i)])
      mic
  end

for stream <- [level, speaking, mic], do: {:ok, _} = Writer.close_stream(stream, t0 + hour)
:ok = Writer.close(writer)

{:ok, _} = Application.ensure_all_started(:situ_studio)
{:ok, studio} = Situ.Studio.start_link(id: "zoom", port: 0, path: folder)

IO.puts(
  "ready " <>
    Situ.JSON.encode(%{"main" => studio |> Situ.Studio.url() |> String.trim_trailing("/")})
)

Process.sleep(:infinity)
