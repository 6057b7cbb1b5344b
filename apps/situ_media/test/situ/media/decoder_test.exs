defmodule Situ.Media.DecoderTest do
  use ExUnit.Case, async: true

  import Situ.Media.TestFiles
  alias Situ.{AudioBuffer, AudioFormat, Image, Time}
  alias Situ.Media.{Decoder, FFmpeg, FileInfo}

  doctest Situ.Media.FFmpeg
  doctest Situ.Media.FileInfo

  @talk path("talk1.mp4")

  describe "a complete file" do
    test "yields 350 images at exact 40 ms steps and 14.0 s of audio in sync" do
      {items, :eof} = read(@talk, size: {64, 32})
      assert times(items, :video) == for(i <- 0..349, do: Time.ms(40) * i)
      assert times(items, :audio) == for(i <- 1..700, do: Time.ms(20) * i)
      assert frames(items) == 14 * 16_000

      # Items are in time order: audio and video are never more than one image and one buffer apart.
      assert Enum.all?(gaps(items), &(abs(&1) <= Time.ms(80)))
    end

    test "yields images as recorded, equal to ffmpeg's own decoding" do
      {[{:video, 0, image} | _], _} = read(@talk, audio: false, end: Time.ms(40))
      assert %Image{width: 1024, height: 512, format: :bgr24, stride: 3072} = image
      assert {:ok, _} = Image.validate(image)

      {reference, 0} =
        System.cmd(
          "ffmpeg",
          ~w(-v error -i #{@talk} -frames:v 1 -pix_fmt bgr24 -f rawvideo pipe:1)
        )

      assert image.data == reference
    end

    test "converts to any pixel format, size and audio format" do
      for format <- Image.Format.list_all() do
        {[{:video, 0, image} | _], _} =
          read(@talk, audio: false, end: Time.ms(40), format: format, size: {30, 16})

        assert {:ok, %{format: ^format, width: 30, height: 16}} = Image.validate(image)
      end

      for sample <- [:u8, :s24, :f32] do
        format = AudioFormat.pcm(48_000, 2, sample)
        opts = [video: false, end: Time.ms(500), audio_format: format, audio_buffer: Time.ms(10)]
        {items, :eof} = read(@talk, opts)
        assert frames(items) == 24_000
        assert {:audio, 10_000_000, %AudioBuffer{format: ^format}} = hd(items)
      end
    end

    defp gaps(items) do
      items
      |> Enum.scan({nil, 0, 0}, fn
        {:video, t, _}, {_, _, a} -> {:video, t, a}
        {:audio, t, _}, {_, v, _} -> {:audio, v, t}
      end)
      |> Enum.map(fn {_, v, a} -> v - a end)
    end
  end

  describe "start: and end:" do
    test "cut to the exact image and sample, in media time" do
      {items, :eof} = read(@talk, size: {16, 8}, start: Time.ms(3010), end: Time.ms(3100))
      assert times(items, :video) == [Time.ms(3040), Time.ms(3080)]
      assert frames(items) == 1440
      assert List.last(times(items, :audio)) == Time.ms(3100)
    end

    test "yield the same images as reading from the start" do
      {whole, :eof} = read(@talk, size: {16, 8}, audio: false, end: Time.s(4))
      {part, :eof} = read(@talk, size: {16, 8}, audio: false, start: Time.s(3), end: Time.s(4))
      assert part == Enum.filter(whole, fn {_, t, _} -> t >= Time.s(3) end)
    end

    test "reject an empty span and a span after the end" do
      assert {[], %{code: :bad_option}} = read(@talk, start: 5, end: 5)
      assert {[], %{code: :bad_option, why: why}} = read(@talk, start: Time.s(14))
      assert why =~ "14.0 s"
    end
  end

  describe "other file types" do
    @describetag :tmp_dir

    test "AVI, MKV, WebM, MPEG-TS and FLV keep their times", %{tmp_dir: dir} do
      for {ending, args} <- [
            avi: ~w(-c:v mpeg4 -c:a pcm_s16le),
            mkv: ~w(-c:v libx264 -c:a flac),
            webm: ~w(-c:v libvpx-vp9 -deadline realtime -c:a libopus),
            ts: ~w(-c:v libx264 -c:a mp2 -ar 48000),
            flv: ~w(-c:v flv1 -c:a mp3 -ar 44100)
          ] do
        file = Path.join(dir, "clip.#{ending}")
        ffmpeg!(~w(-t 1 -i #{@talk} -s 64x32) ++ args ++ [file])
        {items, ended} = read(file)
        assert {ending, ended} == {ending, :eof}
        video = times(items, :video)
        assert {ending, length(video)} == {ending, 25}
        assert hd(video) < Time.ms(100)

        # Containers count in milliseconds or at 90 kHz and may begin slightly late; the steps match the frame rate.
        steps = Enum.zip_with(tl(video), video, &(&1 - &2))
        assert Enum.all?(steps, &(abs(&1 - Time.ms(40)) <= Time.ms(1)))
        assert_in_delta frames(items) / sound_rate(items), 1.0, 0.08
      end
    end

    test "variable frame rates are not rounded", %{tmp_dir: dir} do
      file = Path.join(dir, "vfr.mkv")

      keep = "select=not(mod(n\\,3))+not(mod(n\\,5)),scale=64:32"
      ffmpeg!(~w(-t 2 -i #{@talk} -an -vf) ++ [keep | ~w(-fps_mode vfr #{file})])

      {items, :eof} = read(file)
      expected = for n <- 0..49, rem(n, 3) == 0 or rem(n, 5) == 0, do: n * Time.ms(40)
      assert times(items, :video) == expected
    end

    test "later images of another size are scaled to the first image's size", %{tmp_dir: dir} do
      parts =
        for size <- ["64x32", "128x48"] do
          file = Path.join(dir, size <> ".ts")
          ffmpeg!(~w(-t 0.4 -i #{@talk} -an -s #{size} -c:v mpeg2video #{file}))
          File.read!(file)
        end

      file = Path.join(dir, "both.ts")
      File.write!(file, parts)
      {items, _} = read(file)
      assert length(items) > 12

      assert Enum.all?(items, fn {:video, _, i} ->
               match?({:ok, %{width: 64}}, Image.validate(i))
             end)
    end

    test "reads video-only and audio-only files", %{tmp_dir: dir} do
      silent = Path.join(dir, "silent.mp4")
      ffmpeg!(~w(-t 1 -i #{@talk} -an -c:v copy #{silent}))
      {:ok, %{audio: nil, video: %{width: 1024}}} = FileInfo.read(silent)
      {items, :eof} = read(silent, size: {16, 8})
      assert {length(times(items, :video)) >= 25, times(items, :audio)} == {true, []}
      assert {[], %{code: :no_stream}} = read(silent, video: false)

      sound = Path.join(dir, "sound.mp3")
      ffmpeg!(~w(-t 1 -i #{@talk} -vn #{sound}))
      {items, :eof} = read(sound)
      assert {times(items, :video), frames(items) >= 16_000} == {[], true}
    end

    defp sound_rate(items),
      do: Enum.find_value(items, fn {k, _, b} -> k == :audio && b.format.rate end)
  end

  describe "invalid files" do
    @describetag :tmp_dir

    test "a truncated file yields its readable part, then a clear error", %{tmp_dir: dir} do
      file = Path.join(dir, "cut.mp4")
      File.write!(file, binary_part(File.read!(@talk), 0, 900_000))
      {items, error} = read(file, size: {16, 8})
      video = times(items, :video)
      assert length(video) in 100..300
      assert video == for(i <- 0..(length(video) - 1), do: i * Time.ms(40))
      assert %Situ.Error{code: :damaged_media, what: what, meta: %{log: [_ | _]}} = error
      assert what =~ "cut.mp4 is damaged or truncated"
    end

    test "every cut and scramble ends in data or an error, never in a crash", %{tmp_dir: dir} do
      bytes = File.read!(@talk)
      :rand.seed(:exsss, {1, 2, 3})

      for n <- 1..6 do
        file = Path.join(dir, "bad#{n}.mp4")
        cut = binary_part(bytes, 0, :rand.uniform(byte_size(bytes)))

        scrambled =
          Enum.reduce(1..20, cut, fn _, acc ->
            at = :rand.uniform(byte_size(acc)) - 1
            <<head::binary-size(at), _, tail::binary>> = acc
            head <> <<:rand.uniform(256) - 1>> <> tail
          end)

        File.write!(file, scrambled)
        {items, ended} = read(file, size: {16, 8})
        assert ended == :eof or match?(%Situ.Error{}, ended)
        assert items == [] or Enum.all?(items, fn {_, t, _} -> is_integer(t) end)
      end
    end

    test "a file that is not a media file is an error", %{tmp_dir: dir} do
      text = Path.join(dir, "notes.mp4")
      File.write!(text, "these are only notes\n")
      assert {:error, %{code: :unreadable_media}} = Decoder.open(text)
      assert {:error, %{code: :no_file}} = Decoder.open(Path.join(dir, "absent.mp4"))
      assert {:error, %{code: :no_file}} = Decoder.open(dir)
      empty = Path.join(dir, "empty.mp4")
      File.write!(empty, "")
      assert {:error, %{code: :unreadable_media}} = Decoder.open(empty)
    end

    test "a playlist under another name reads no other file", %{tmp_dir: dir} do
      secret = Path.join(dir, "secret.mp4")
      File.cp!(path("talk1.mp4"), secret)
      hls = "#EXTM3U\n#EXT-X-TARGETDURATION:20\n#EXTINF:14,\nfile:#{secret}\n#EXT-X-ENDLIST\n"
      concat = "ffconcat version 1.0\nfile secret.mp4\n"

      for text <- [hls, concat], name <- ["a.mp4", "a.mkv", "a.ts", "a.m3u8", "a.unknown", "a"] do
        File.write!(Path.join(dir, name), text)
        assert {:error, %{code: :unreadable_media}} = Decoder.open(Path.join(dir, name))
      end

      assert {:ok, decoder} = Decoder.open(secret)
      Decoder.close(decoder)
    end

    test "a playlist cannot reach the network", %{tmp_dir: dir} do
      list = Path.join(dir, "list.m3u8")
      File.write!(list, "#EXTM3U\n#EXTINF:10,\nhttp://127.0.0.1:1/x.ts\n#EXT-X-ENDLIST\n")
      assert {:error, %{code: :unreadable_media}} = Decoder.open(list)
    end

    test "a header that claims 100,000 x 100,000 pixels allocates nothing", %{tmp_dir: dir} do
      for codec <- ~w(ffv1 huffyuv) do
        file = Path.join(dir, "#{codec}.avi")
        ffmpeg!(~w(-t 0.2 -i #{@talk} -an -s 64x32 -c:v #{codec} #{file}))
        huge = <<100_000::little-32, 100_000::little-32>>
        # The main header and the stream's header both contain the size.
        bytes =
          :binary.replace(File.read!(file), <<64::little-32, 32::little-32>>, huge, [:global])

        assert bytes =~ huge
        File.write!(file, bytes)
        assert {[], %Situ.Error{code: :unreadable_media, why: why}} = read(file)
        assert why =~ "100000x100000" or why =~ "headers"
      end
    end

    test "the decoder rejects an image larger than the limit" do
      assert {[], %{code: :unreadable_media}} = read(@talk, audio: false, max_pixels: 1000)
    end
  end

  describe "processes" do
    test "closing in the middle ends ffmpeg and removes its socket" do
      {:ok, decoder} = Decoder.open(@talk, loop: true)
      {:video, 0, _, decoder} = Decoder.next_item(decoder)
      {:ok, port} = reader_port(decoder)
      {:os_pid, os_pid} = Port.info(port, :os_pid)

      # Find its own socket by its command line, because other tests have decoders open at the same time.
      [_, socket] = Regex.run(~r{unix:(/[^\0]+)}, File.read!("/proc/#{os_pid}/cmdline"))
      :ok = Decoder.close(decoder)
      assert ended?(os_pid, 200)
      refute File.exists?(Path.dirname(socket))
    end

    test "reads nothing ahead of demand" do
      {:ok, decoder} = Decoder.open(@talk, audio: false, loop: true)
      {:video, 0, _, decoder} = Decoder.next_item(decoder)
      {:message_queue_len, queued} = Process.info(decoder.reader, :message_queue_len)
      assert queued == 0
      Decoder.close(decoder)
    end

    test "without ffmpeg, the error says which package to install" do
      assert {:error, %{code: :no_ffmpeg, fix: fix}} =
               FFmpeg.fetch_executable("ffmpeg-that-is-absent")

      assert fix =~ "apt-get install ffmpeg"
    end

    defp reader_port(decoder) do
      {:links, links} = Process.info(decoder.reader, :links)
      Enum.find(links, &(is_port(&1) and Port.info(&1, :name) == {:name, ~c"/bin/sh"})) |> ok()
    end

    defp ok(nil), do: :error
    defp ok(port), do: {:ok, port}

    # The guard kills it when the port closes; the kernel reports the exit a moment later.
    defp ended?(_os_pid, 0), do: false

    defp ended?(os_pid, tries) do
      {_, status} = System.cmd("ps", ["-p", "#{os_pid}", "-o", "pid="])
      status != 0 or ended?(os_pid, tries - 1)
    end
  end
end
