defmodule Situ.Media.EncoderTest do
  use ExUnit.Case, async: true

  import Situ.Media.TestFiles
  alias Situ.{AudioBuffer, AudioFormat, Image, Time}
  alias Situ.Media.{Encoder, FileInfo}

  @moduletag :tmp_dir
  @start 1_700_000_000_123_456_789

  defp write(path, items, opts \\ []) do
    image = Enum.find_value(items, fn {kind, _, data} -> kind == :video && data end)
    audio = Enum.find_value(items, fn {kind, _, data} -> kind == :audio && data.format end)
    opts = [video: image, audio: audio, start_time: @start] ++ opts
    {:ok, encoder} = Encoder.open(path, opts)

    for {kind, time, data} <- items do
      assert :ok == apply(Encoder, kind, [encoder, @start + time, data])
    end

    Encoder.close(encoder)
  end

  # Uneven steps, as from a camera.
  defp uneven(items) do
    for {kind, time, data} <- items,
        kind == :audio or rem(div(time, Time.ms(40)), 3) != 1,
        do: {kind, time, data}
  end

  test "MP4, MOV, MKV and WebM preserve the time of every frame exactly", %{tmp_dir: dir} do
    {items, :eof} = read(path("talk1.mp4"), size: {64, 32}, end: Time.s(2))
    items = uneven(items)

    for ending <- ~w(mp4 mov mkv webm), opts <- [[], [fragmented: true]] do
      file = Path.join(dir, "out.#{ending}")
      assert :ok = write(file, items, opts)
      assert {:ok, %FileInfo{recorded_at: @start} = info} = FileInfo.read(file)
      assert {info.video.width, info.video.height} == {64, 32}
      {again, :eof} = read(file, audio_format: AudioFormat.pcm())
      assert times(again, :video) == times(items, :video)
      assert Enum.take(times(again, :audio), 100) == times(items, :audio)
      assert in_step?(again, items)
    end
  end

  test "written media matches its input within the loss of the codec", %{tmp_dir: dir} do
    {items, :eof} = read(path("talk1.mp4"), size: {64, 32}, end: Time.ms(400))
    file = Path.join(dir, "out.mkv")
    :ok = write(file, items, quality: 0)
    {again, :eof} = read(file)
    # FLAC is lossless.
    assert sound(again) == sound(items)
    assert mean_error(items, again) < 3.0
  end

  test "writes audio-only and video-only files", %{tmp_dir: dir} do
    {items, :eof} = read(path("talk1.mp4"), video: false, end: Time.s(1))

    for ending <- ~w(m4a flac opus mp3 mka) do
      file = Path.join(dir, "sound.#{ending}")
      assert :ok = write(file, items)
      assert {:ok, %{video: nil, audio: %{}}} = FileInfo.read(file)
    end

    {items, :eof} = read(path("talk1.mp4"), audio: false, size: {33, 17}, end: Time.ms(200))
    file = Path.join(dir, "odd.mp4")
    assert :ok = write(file, items)
    # Players expect even sizes, so an odd size gets one more row and column.
    assert {:ok, %{audio: nil, video: %{width: 34, height: 18}}} = FileInfo.read(file)
  end

  test "a gap in the audio becomes silence", %{tmp_dir: dir} do
    {items, :eof} = read(path("talk1.mp4"), size: {64, 32}, end: Time.s(2))

    holed =
      Enum.reject(items, fn {k, t, _} ->
        k == :audio and t > Time.ms(500) and t <= Time.ms(1000)
      end)

    file = Path.join(dir, "gap.mkv")
    :ok = write(file, holed)
    {again, :eof} = read(file)
    assert_in_delta frames(again), 32_000, 320
  end

  test "unsuitable input is an error that gives the reason", %{tmp_dir: dir} do
    image = Image.new_filled(16, 16, :bgr24)
    format = AudioFormat.pcm()
    file = Path.join(dir, "x.mp4")
    {:ok, encoder} = Encoder.open(file, video: image, audio: format, start_time: 1000)

    assert {:error, %{code: :bad_image}} =
             Encoder.video(encoder, 1000, Image.new_filled(8, 8, :bgr24))

    assert {:error, %{code: :bad_image}} =
             Encoder.video(encoder, 1000, Image.new_filled(16, 16, :gray8))

    other = AudioBuffer.build_silence(AudioFormat.pcm(8_000), 160)
    assert {:error, %{code: :bad_audio}} = Encoder.audio(encoder, 1_000_000_000, other)
    assert {:error, %{code: :before_start}} = Encoder.video(encoder, 999, image)
    assert :ok = Encoder.video(encoder, 1000, image)
    assert :ok = Encoder.close(encoder)

    assert {:error, %{code: :bad_option}} = Encoder.open(file, start_time: 0)
    open = &Encoder.open(Path.join(dir, &1), video: image, start_time: 0)
    assert {:error, %{code: :bad_option}} = open.("x.avi")
    assert {:error, %{code: :bad_option}} = open.("x.flac")
    assert {:error, %{code: :cannot_write}} = open.("absent/x.mp4")
  end

  test "an encoder that cannot write reports an error", %{tmp_dir: dir} do
    image = Image.new_filled(64, 64, :bgr24, 7)
    folder = Path.join(dir, "taken.mp4")
    File.mkdir!(folder)
    {:ok, encoder} = Encoder.open(folder, video: image, start_time: 0)
    results = for i <- 1..200, do: Encoder.video(encoder, i * Time.ms(40), image)

    assert Enum.any?(
             results ++ [Encoder.close(encoder)],
             &match?({:error, %{code: :cannot_write}}, &1)
           )
  end

  # The loudest moments of both are at the same samples, within the blur of a codec.
  defp in_step?(again, items), do: abs(peak(again) - peak(items)) <= 16

  defp peak(items) do
    samples = for <<v::little-signed-16 <- sound(items)>>, do: abs(v)
    {_, at} = samples |> Enum.with_index() |> Enum.max()
    at
  end

  defp sound(items), do: IO.iodata_to_binary(for {:audio, _, b} <- items, do: b.data)

  defp mean_error(items, again) do
    pairs =
      Enum.zip(for({:video, _, i} <- items, do: i.data), for({:video, _, i} <- again, do: i.data))

    errors =
      for {a, b} <- pairs,
          {x, y} <- Enum.zip(:binary.bin_to_list(a), :binary.bin_to_list(b)),
          do: abs(x - y)

    Enum.sum(errors) / length(errors)
  end
end
