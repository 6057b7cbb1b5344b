defmodule Situ.Media.WavTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  import Situ.Media.TestFiles, only: [path: 1, ffmpeg!: 1]
  alias Situ.{AudioBuffer, AudioFormat, Time}
  alias Situ.Media.Wav
  alias Situ.Media.Wav.{Reader, Writer}

  doctest Situ.Media.Wav

  @moduletag :tmp_dir

  defp read_all(path, opts \\ []) do
    case Reader.open(path, opts) do
      {:ok, reader} -> collect(Reader.next_buffer(reader), [])
      {:error, error} -> {[], error}
    end
  end

  defp collect({:ok, time, buffer, reader}, pieces),
    do: collect(Reader.next_buffer(reader), [{time, buffer} | pieces])

  defp collect(:eof, pieces), do: {Enum.reverse(pieces), :eof}
  defp collect({:error, error}, pieces), do: {Enum.reverse(pieces), error}

  test "reads a real recording with sample-exact times" do
    {pieces, :eof} = read_all(path("cards_001.wav"))
    {times, buffers} = Enum.unzip(pieces)
    {:ok, whole} = Wav.read(path("cards_001.wav"))
    assert {:ok, ^whole} = AudioBuffer.concat(buffers)
    assert Enum.take(times, 3) == [Time.ms(20), Time.ms(40), Time.ms(60)]
    assert List.last(times) == AudioBuffer.duration_ns(whole)
    assert whole.format == AudioFormat.pcm(16_000)
  end

  test "start: and end: seek to the sample" do
    {:ok, whole} = Wav.read(path("cards_001.wav"))
    {pieces, :eof} = read_all(path("cards_001.wav"), start: Time.ms(105), end: Time.ms(150))
    assert {:ok, part} = AudioBuffer.concat(Enum.map(pieces, &elem(&1, 1)))
    assert part == AudioBuffer.slice_frames(whole, 1680, 720)
    assert Enum.map(pieces, &elem(&1, 0)) == [Time.ms(125), Time.ms(145), Time.ms(150)]
  end

  test "every format survives a round trip, and ffmpeg reads the same samples", %{tmp_dir: dir} do
    for sample <- AudioFormat.sample_types(), channels <- [1, 2, 6] do
      format = AudioFormat.pcm(44_100, channels, sample)

      values =
        for i <- 1..(channels * 50),
            do: if(sample in [:f32, :f64], do: i / 512, else: rem(i, 128))

      buffer = AudioBuffer.from_samples(values, format)
      file = Path.join(dir, "#{sample}#{channels}.wav")
      assert :ok = Wav.write(file, buffer)
      assert Wav.read(file) == {:ok, buffer}

      {raw, 0} = System.cmd("ffmpeg", ~w(-v error -i #{file} -f #{raw_format(sample)} pipe:1))

      assert raw == buffer.data
    end
  end

  test "reads ffmpeg's output, including RF64 and streamed files", %{tmp_dir: dir} do
    for {name, args} <- [
          plain: ~w(-c:a pcm_s16le),
          extensible: ~w(-c:a pcm_s24le -ac 3),
          rf64: ~w(-c:a pcm_s16le -rf64 always)
        ] do
      file = Path.join(dir, "#{name}.wav")
      ffmpeg!(~w(-i #{path("cards_001.wav")}) ++ args ++ [file])
      assert {:ok, %AudioBuffer{} = buffer} = Wav.read(file)
      assert AudioBuffer.frame_count(buffer) == 17_526
    end

    {streamed, 0} = System.cmd("ffmpeg", ~w(-v error -i #{path("cards_001.wav")} -f wav pipe:1))
    file = Path.join(dir, "streamed.wav")
    File.write!(file, streamed)
    assert {:ok, buffer} = Wav.read(file)
    assert Wav.read(path("cards_001.wav")) == {:ok, buffer}
  end

  test "keeps the start time of a recording to the nanosecond", %{tmp_dir: dir} do
    file = Path.join(dir, "timed.wav")
    start = 1_700_000_000_123_456_789
    :ok = Wav.write(file, AudioBuffer.build_silence(AudioFormat.pcm(), 100), start_time: start)
    assert {:ok, %{recorded_at: ^start}} = Reader.open(file)
    assert {:ok, %{recorded_at: nil}} = Reader.open(path("cards_001.wav"))
  end

  test "reads a file whose writer died up to its end", %{tmp_dir: dir} do
    file = Path.join(dir, "dead.wav")
    {:ok, writer} = Writer.open(file, AudioFormat.pcm())

    {:ok, writer} =
      Writer.append_buffer(writer, AudioBuffer.build_silence(AudioFormat.pcm(), 500))

    :ok = :file.close(writer.file)
    assert {:ok, buffer} = Wav.read(file)
    assert AudioBuffer.frame_count(buffer) == 500
  end

  test "a truncated file yields all complete frames and reports the rest", %{tmp_dir: dir} do
    file = Path.join(dir, "cut.wav")
    bytes = File.read!(path("cards_001.wav"))
    File.write!(file, binary_part(bytes, 0, 10_045))
    {pieces, error} = read_all(file)
    assert Enum.sum(Enum.map(pieces, fn {_, b} -> AudioBuffer.frame_count(b) end)) == 5_000
    assert %Situ.Error{code: :damaged_media, why: why} = error
    assert why =~ "header states"
    assert {:error, %{code: :damaged_media}} = Wav.read(file)
    # The existing part can be read without an error.
    assert {[_ | _], :eof} = read_all(file, end: Time.ms(200))
  end

  test "rejects impossible headers", %{tmp_dir: dir} do
    file = Path.join(dir, "bad.wav")
    fmt = Wav.Format.encode_chunk(AudioFormat.pcm())

    wav = fn chunks ->
      File.write!(file, ["RIFF", <<0::32>>, "WAVE", chunks])
      Reader.open(file)
    end

    chunk = fn id, body -> [id, <<byte_size(body)::little-32>>, body] end
    assert {:error, %{code: :unreadable_media}} = wav.([])
    assert {:error, %{code: :unreadable_media}} = wav.(chunk.("data", <<0, 0>>))
    assert {:error, %{code: :unreadable_media}} = wav.(for _ <- 1..300, do: chunk.("JUNK", <<>>))
    # A chunk that claims four gigabytes is skipped, not read.
    assert {:error, %{code: :unreadable_media}} = wav.(["JUNK", <<0xFFFFFFF0::little-32>>])

    for <<(at <- <<2, 4, 12, 14>>)>> do
      <<head::binary-size(at), _::16, tail::binary>> = fmt
      zeroed = head <> <<0, 0>> <> tail
      assert {:error, %Situ.Error{}} = wav.([chunk.("fmt ", zeroed), chunk.("data", <<0, 0>>)])
    end

    alaw = <<6::little-16>> <> binary_part(fmt, 2, 14)
    assert {:error, %{why: why}} = wav.([chunk.("fmt ", alaw), chunk.("data", <<0>>)])
    assert why =~ "compressed"
  end

  property "any bytes after a valid start end in audio or an error", context: %{tmp_dir: dir} do
    forall {bytes, cut} <- {binary(), integer(12, 60)} do
      file = Path.join(dir, "fuzz.wav")
      start = binary_part(File.read!(path("cards_001.wav")), 0, cut)
      File.write!(file, [start, bytes])
      {pieces, ended} = read_all(file)
      assert is_list(pieces) and (ended == :eof or match?(%Situ.Error{}, ended))
    end
  end

  defp raw_format(:u8), do: "u8"
  defp raw_format(sample), do: "#{sample}le"
end
