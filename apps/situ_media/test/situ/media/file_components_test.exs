defmodule Situ.Media.FileComponentsTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog
  import Situ.Media.TestFiles, only: [path: 1, ffmpeg!: 1]
  import Situ.Media.TestPipelines
  alias Situ.{AudioBuffer, AudioFormat, Image, Time}
  alias Situ.Media.{FileInfo, VideoFile, VideoWriter, Wav, WavFile, WavWriter}

  doctest Situ.Media.FileTime

  @talk path("talk1.mp4")
  @recorded 1_700_000_000_000_000_000

  defp times(messages), do: Enum.map(messages, &elem(&1, 0))

  describe "VideoFile" do
    test "emits 350 images at exact 40 ms steps and 14.0 s of audio, the same in every run" do
      run = fn -> collect(&VideoFile.open(&1, @talk, size: {32, 16})) end
      {{:ok, _}, %{video: video, audio: audio} = first} = run.()
      assert times(video) == for(i <- 0..349, do: Time.ms(40) * i)
      assert times(audio) == for(i <- 1..700, do: Time.ms(20) * i)
      assert Enum.sum(for {_, b} <- audio, do: AudioBuffer.frame_count(b)) == 14 * 16_000
      assert {{:ok, _}, ^first} = run.()
    end

    test "start_time: sets the time of media time 0, at which the pipeline's clock begins" do
      {{:ok, report}, %{video: [{first, %Image{}} | _]}} =
        collect(
          &VideoFile.open(&1, @talk,
            audio: false,
            start_time: @recorded,
            start: Time.s(2),
            end: Time.s(3)
          )
        )

      assert first == @recorded + Time.s(2)
      assert report.start_time == @recorded + Time.s(2)
    end

    test "start_time: :pipeline places the first image at the pipeline's start" do
      {{:ok, report}, %{video: [{first, _} | _]}} =
        collect(
          &VideoFile.open(&1, @talk, audio: false, start_time: :pipeline, start: Time.s(13))
        )

      assert first == report.start_time
      assert first > @recorded
    end

    test "reads only the pipeline's replay interval" do
      interval = {Time.s(1), Time.ms(1200)}

      {{:ok, _}, %{video: video}} =
        collect(&VideoFile.open(&1, @talk, audio: false, size: {32, 16}),
          pipeline: [replay: [interval: interval, speed: :max]]
        )

      assert times(video) == for(i <- 25..30, do: Time.ms(40) * i)
    end

    @tag :tmp_dir
    test "a missing stream is nil, and a disabled stream is not read", %{tmp_dir: dir} do
      silent = Path.join(dir, "silent.mp4")
      ffmpeg!(~w(-t 1 -i #{@talk} -an -c:v copy #{silent}))
      test = self()

      {{:ok, _}, %{video: video} = all} =
        collect(fn p ->
          clip = VideoFile.open(p, silent, size: {32, 16})
          send(test, {:clip, clip})
          clip
        end)

      assert_received {:clip, %{video: %Situ.Stream{type: Situ.Image}, audio: nil}}
      assert length(video) >= 25 and map_size(all) == 1

      assert {{:error, %{code: :no_stream}}, _} =
               collect(&VideoFile.open(&1, silent, video: false))
    end

    @tag :tmp_dir
    test "a damaged file gives its readable part, then an error or warning", %{tmp_dir: dir} do
      file = Path.join(dir, "cut.mp4")
      File.write!(file, binary_part(File.read!(@talk), 0, 900_000))
      open = &VideoFile.open(&1, file, [size: {32, 16}] ++ &2)

      assert capture_log(fn ->
               assert {{:error, error}, %{video: video}} = collect(&open.(&1, []))
               assert %Situ.Error{code: :damaged_media, meta: %{component: "VideoFile"}} = error
               assert length(video) > 100
               assert times(video) == for(i <- 0..(length(video) - 1), do: i * Time.ms(40))
               assert {{:ok, _}, %{video: ^video}} = collect(&open.(&1, on_damage: :warn))
             end) =~ "cut.mp4 is damaged"
    end

    test "a missing file is a build error" do
      assert {:error, %{code: :no_file}} = Situ.Pipeline.run(&VideoFile.open(&1, "absent.mp4"))
    end

    test "plays in real time on request" do
      clock = fn -> System.monotonic_time(:millisecond) end
      from = clock.()

      {{:ok, _}, %{video: video}} =
        collect(&VideoFile.open(&1, @talk, audio: false, size: {32, 16}, end: Time.ms(800)),
          pipeline: [replay: [speed: 1.0]]
        )

      assert length(video) == 20
      assert clock.() - from >= 750
    end
  end

  describe "VideoWriter" do
    @describetag :tmp_dir

    test "a copy has the times of the original", %{tmp_dir: dir} do
      file = Path.join(dir, "copy.mp4")
      opts = [size: {64, 32}, start_time: @recorded, end: Time.s(2)]

      {{:ok, _}, original} =
        collect(fn p ->
          clip = VideoFile.open(p, @talk, opts)
          VideoWriter.write([video: clip.video, audio: clip.audio], file)
          clip
        end)

      assert {:ok, %{recorded_at: @recorded, exact?: true}} = FileInfo.read(file)
      {{:ok, _}, copy} = collect(&VideoFile.open(&1, file))
      assert times(copy.video) == times(original.video)
      assert times(copy.audio) == times(original.audio)
    end

    test "writes one stream alone, or both when one starts late", %{tmp_dir: dir} do
      file = Path.join(dir, "silent.mkv")

      {{:ok, _}, _} =
        collect(fn p ->
          clip = VideoFile.open(p, @talk, size: {64, 32}, end: Time.s(1))
          VideoWriter.write([video: clip.video], file)
          VideoWriter.write([audio: clip.audio], Path.join(dir, "sound.flac"))

          late =
            Situ.filter(clip.audio, fn _, message -> message.originating_time > Time.ms(500) end)

          VideoWriter.write([video: clip.video, audio: late], Path.join(dir, "late.mp4"))
          %{}
        end)

      assert {:ok, %{audio: nil, video: %{width: 64}}} = FileInfo.read(file)
      assert {:ok, %{video: nil}} = FileInfo.read(Path.join(dir, "sound.flac"))
      {{:ok, _}, late} = collect(&VideoFile.open(&1, Path.join(dir, "late.mp4")))
      assert length(late.video) == 25
      assert_in_delta List.last(times(late.audio)), Time.s(1), Time.ms(70)
    end

    test "images that change size are an error that gives the reason", %{tmp_dir: dir} do
      assert capture_log(fn ->
               {{:error, error}, _} =
                 collect(fn p ->
                   clip = VideoFile.open(p, @talk, size: {64, 32}, end: Time.s(1), audio: false)

                   grown =
                     Situ.map(
                       clip.video,
                       fn image, message ->
                         if message.originating_time > Time.ms(500),
                           do: Image.new_filled(8, 8, :bgr24),
                           else: image
                       end,
                       type: Image
                     )

                   VideoWriter.write([video: grown], Path.join(dir, "x.mp4"))
                   %{}
                 end)

               assert error.code == :bad_image
             end) =~ "same size"
    end
  end

  describe "WavFile and WavWriter" do
    @describetag :tmp_dir

    test "a copy is identical to the original file", %{tmp_dir: dir} do
      copy = Path.join(dir, "copy.wav")

      {{:ok, _}, %{out: out}} =
        collect(fn p ->
          %{out: p |> WavFile.open(path("cards_001.wav")) |> WavWriter.write(copy)}
        end)

      {:ok, whole} = Wav.read(path("cards_001.wav"))
      assert Wav.read(copy) == {:ok, whole}
      assert Enum.take(times(out), 2) == [Time.ms(20), Time.ms(40)]
      assert List.last(times(out)) == AudioBuffer.duration_ns(whole)
    end

    test "preserves the start time", %{tmp_dir: dir} do
      copy = Path.join(dir, "copy.wav")

      collect(fn p ->
        p |> WavFile.open(path("cards_001.wav"), start_time: @recorded) |> WavWriter.write(copy)
        %{}
      end)

      {{:ok, _}, %{out: [{first, _} | _]}} = collect(&%{out: WavFile.open(&1, copy)})
      assert first == @recorded + Time.ms(20)
    end

    test "fills gaps on request", %{tmp_dir: dir} do
      for {fill, frames} <- [{true, 17_526}, {false, 17_526 - 1600}] do
        file = Path.join(dir, "gap#{fill}.wav")

        collect(fn p ->
          p
          |> WavFile.open(path("cards_001.wav"))
          |> Situ.filter(fn _, m ->
            m.originating_time <= Time.ms(500) or m.originating_time > Time.ms(600)
          end)
          |> WavWriter.write(file, fill_gaps: fill)

          %{}
        end)

        assert {:ok, buffer} = Wav.read(file)
        assert AudioBuffer.frame_count(buffer) == frames
      end
    end

    test "a truncated file gives its audio, then an error", %{tmp_dir: dir} do
      file = Path.join(dir, "cut.wav")
      File.write!(file, binary_part(File.read!(path("cards_001.wav")), 0, 10_045))

      capture_log(fn ->
        assert {{:error, %{code: :damaged_media}}, %{out: out}} =
                 collect(&%{out: WavFile.open(&1, file)})

        assert Enum.sum(for {_, b} <- out, do: AudioBuffer.frame_count(b)) == 5_000
        assert {{:ok, _}, _} = collect(&%{out: WavFile.open(&1, file, on_damage: :warn)})
      end)
    end

    test "a format change is an error", %{tmp_dir: dir} do
      capture_log(fn ->
        {{:error, error}, _} =
          collect(fn p ->
            p
            |> WavFile.open(path("cards_001.wav"))
            |> Situ.map(
              fn buffer, m ->
                if m.originating_time > Time.ms(100),
                  do: AudioBuffer.build_silence(AudioFormat.pcm(8_000), 160),
                  else: buffer
              end,
              type: AudioBuffer
            )
            |> WavWriter.write(Path.join(dir, "x.wav"))

            %{}
          end)

        assert error.code == :bad_audio
      end)
    end
  end
end
