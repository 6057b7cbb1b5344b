defmodule Situ.Media.RecordingTest do
  use ExUnit.Case, async: true

  import Situ.Media.TestFiles
  alias Situ.{AudioBuffer, Pipeline, AudioOps, Store, Time}
  alias Situ.Media.Recording
  alias Situ.Media.Recording.Images

  doctest Situ.Media.Recording.Index
  doctest Situ.Media.Recording.Waveform

  @moduletag :tmp_dir
  @talk path("talk1.mp4")

  # Two seconds with a keyframe every 15 frames, B-frames stored out of order, and a tone.
  defp clip(root, ending, codecs) do
    file = Path.join(root, "clip." <> ending)

    ffmpeg!(~w(-f lavfi -i testsrc2=size=160x120:rate=30000/1001:duration=2
         -f lavfi -i sine=duration=2:sample_rate=44100) ++ codecs ++ [file])

    file
  end

  defp mp4(root),
    do: clip(root, "mp4", ~w(-c:v libx264 -g 15 -bf 2 -pix_fmt yuv420p -c:a aac))

  defp got(store, name),
    do: store |> Store.messages(name) |> Enum.map(&{&1.originating_time, &1.data})

  defp wanted(items, kind), do: for({^kind, time, data} <- items, do: {time, data})

  test "opens a video file by its extension and lists its streams" do
    assert Situ.Recording.Formats.for_file("somewhere/CLIP.MP4") == Recording
    store = Store.open!(@talk)
    assert %{name: "talk1", closed?: true, live?: false, damage: []} = Store.info(store)

    assert [
             %{name: "Video", type: Situ.Image, count: 350, first: 0, last: 13_960_000_000},
             %{name: "Audio", type: AudioBuffer, count: 700, first: 20_000_000} = audio
           ] = Store.streams(store)

    assert {audio.last, audio.size, Store.interval(store)} ==
             {Time.s(14), 448_000, {0, Time.s(14)}}

    assert {:ok, %{data: %{width: 1024, height: 512}, originating_time: 1_480_000_000}} =
             Store.latest_at(store, "Video", Time.ms(1_519))

    noon = 1_700_000_000_000_000_000
    assert {:ok, later} = Store.open(@talk, reader_opts: [start: noon])
    assert Store.interval(later) == {noon, noon + Time.s(14)}
  end

  test "contains exactly the messages of the file source, read forward and at random", %{
    tmp_dir: root
  } do
    file = mp4(root)
    {items, :eof} = read(file)
    store = Store.open!(file)
    pictures = got(store, "Video")
    assert length(pictures) == 60
    assert pictures == wanted(items, :video)
    assert got(store, "Audio") == wanted(items, :audio)

    for i <- [59, 58, 31, 30, 29, 0, 44] do
      {time, image} = Enum.at(pictures, i)
      assert {:ok, %{data: ^image, sequence_id: id}} = Store.latest_at(store, "Video", time + 1)
      assert id == i + 1
      assert {:ok, %{data: ^image}} = Store.first_at(store, "Video", time)
    end

    # A process that has just read something else has other decoders and images cached. The result must be the same.
    {from, _} = Enum.at(pictures, 20)
    {to, _} = Enum.at(pictures, 27)
    {:ok, some} = Store.read(store, "Video", from: from, to: to)
    assert Enum.map(some, &{&1.originating_time, &1.data}) == Enum.slice(pictures, 20..27)
    assert {:ok, nil} = Store.first_at(store, "Video", Time.s(3))
  end

  test "a jump decodes one image, a step back also those before it, all equal to a full decode",
       %{
         tmp_dir: root
       } do
    # There is only one keyframe, so every jump decodes a long run of frames.
    file = clip(root, "mp4", ~w(-c:v libx264 -preset ultrafast -g 250 -bf 2 -pix_fmt yuv420p -an))
    {items, :eof} = read(file, audio: false)
    whole = items |> wanted(:video) |> Enum.map(&elem(&1, 1)) |> List.to_tuple()
    assert tuple_size(whole) == 60
    {:ok, recording} = Recording.open(file, [])
    key = {Images, recording.path, recording.version, recording.print}

    kept = fn ->
      [{pid, _}] = Registry.lookup(Situ.Media.Recording.Registry, key)
      :sys.get_state(pid).cache |> Map.keys() |> Enum.sort()
    end

    assert {:ok, [{40, image}]} = Images.fetch_range(recording, 40, 1)
    assert image == elem(whole, 40)
    assert kept.() == [40]
    # After one step back, the 24 images before it are decoded too.
    assert {:ok, [{39, image}]} = Images.fetch_range(recording, 39, 1)
    assert image == elem(whole, 39)
    assert kept.() == Enum.to_list(15..40)

    for i <- [59, 7, 58, 0, 31, 5, 6, 30, 29, 50] do
      assert {:ok, [{^i, image}]} = Images.fetch_range(recording, i, 1)
      assert image == elem(whole, i)
    end
  end

  test "reads every container, including Matroska's millisecond times and missing MPEG times", %{
    tmp_dir: root
  } do
    file = clip(root, "mkv", ~w(-c:v libx264 -g 15 -pix_fmt yuv420p -c:a flac))
    {items, :eof} = read(file)
    store = Store.open!(file)
    assert got(store, "Video") == wanted(items, :video)
    # The end time of the audio is accurate to a millisecond; its samples are exact.
    {times, sound} = store |> got("Audio") |> Enum.unzip()
    {wanted_times, wanted_sound} = items |> wanted(:audio) |> Enum.unzip()
    assert Enum.take(sound, 99) == Enum.take(wanted_sound, 99)
    assert Enum.zip(times, wanted_times) |> Enum.all?(fn {a, b} -> abs(a - b) <= Time.ms(1) end)
    assert_in_delta sound |> Enum.map(&AudioBuffer.frame_count/1) |> Enum.sum(), 88_200, 45

    file = clip(root, "mpg", ~w(-c:v mpeg2video -g 15 -bf 2 -c:a mp2))
    {items, :eof} = read(file)
    pictures = file |> Store.open!() |> got("Video")
    # The file stores no time for the last frame.
    assert length(pictures) >= 59
    assert pictures == items |> wanted(:video) |> Enum.take(length(pictures))
  end

  test "an audio-only file opens as an audio recording", %{tmp_dir: root} do
    file = clip(root, "flac", ~w(-vn -c:a flac))
    {items, :eof} = read(file)
    store = Store.open!(file)
    assert [%{name: "Audio"}] = Store.streams(store)
    assert got(store, "Audio") == wanted(items, :audio)
  end

  test "a pause longer than one decoding step is silence, and the audio continues", %{
    tmp_dir: root
  } do
    file = Path.join(root, "pause.mkv")

    # A tone of one second at the start and another at second 70, with no packets between them.
    ffmpeg!(
      ~w{-f lavfi -i sine=duration=2:sample_rate=8000 -af asetpts='if(gte(N,8000),PTS+70/TB,PTS)'} ++
        ~w{-c:a flac} ++ [file]
    )

    store = Store.open!(file)
    loud = fn m -> AudioOps.level(m.data) |> elem(1) |> Map.fetch!(:peak) > 0.01 end

    seconds =
      store
      |> Store.messages("Audio")
      |> Enum.filter(loud)
      |> Enum.map(&div(&1.originating_time, Time.s(1)))

    assert Enum.uniq(seconds) -- [0, 1, 71, 72] == []
    assert 71 in seconds
  end

  test "reading only times decodes nothing", %{tmp_dir: root} do
    store = Store.open!(mp4(root))
    {:ok, all} = Store.read(store, "Video", envelopes: true)
    assert Enum.map(all, & &1.data) == List.duplicate(nil, 60)
    {:ok, %{data: nil, originating_time: time}} = Store.at(store, "Video", 30, envelopes: true)
    assert {:ok, %{originating_time: ^time, data: %Situ.Image{}}} = Store.at(store, "Video", 30)
  end

  test "the waveform matches the samples at wide and narrow bins", %{tmp_dir: root} do
    file = mp4(root)
    store = Store.open!(file)
    {items, :eof} = read(file, video: false)

    points =
      for {:audio, time, buffer} <- items, point <- AudioBuffer.points(buffer, time), do: point

    extremes = fn points ->
      {points |> Enum.map(&elem(&1, 1)) |> Enum.min(),
       points |> Enum.map(&elem(&1, 2)) |> Enum.max()}
    end

    {:ok, width, bins} = Store.summary(store, "Audio", 0, Time.s(2), 20)
    assert width == 67_108_864
    assert Enum.all?(bins, &(rem(elem(&1, 0), width) == 0))
    {low, high} = extremes.(bins)
    {wanted_low, wanted_high} = extremes.(points)
    assert_in_delta low, wanted_low, 1.0e-6
    assert_in_delta high, wanted_high, 1.0e-6
    assert bins |> Enum.map(&elem(&1, 4)) |> Enum.sum() == frames(items)

    {from, to} = {Time.ms(500), Time.ms(600)}
    {:ok, width, bins} = Store.summary(store, "Audio", from, to, 100)
    assert width == 524_288
    inside = Enum.filter(points, &(elem(&1, 0) in from..to))
    assert extremes.(bins) == extremes.(inside)
  end

  test "replays in a pipeline from a given time", %{tmp_dir: root} do
    file = mp4(root)
    {items, :eof} = read(file)
    test = self()

    {:ok, _} =
      Pipeline.run(
        fn p ->
          clip = Store.importer(p, file)

          for name <- ["Video", "Audio"],
              do: Store.stream(clip, name) |> Situ.each(&send(test, &1))
        end,
        pipeline: [replay: [interval: {Time.s(1), Time.s(2)}]]
      )

    wanted = for {_, time, data} <- items, time >= Time.s(1), do: data
    for data <- wanted, do: assert_received(^data)
    refute_received _
  end

  test "a truncated file gives its readable part, then an error", %{tmp_dir: root} do
    whole = clip(root, "mkv", ~w(-c:v libx264 -g 15 -pix_fmt yuv420p -an))
    cut = Path.join(root, "cut.mkv")
    bytes = File.read!(whole)
    File.write!(cut, binary_part(bytes, 0, div(byte_size(bytes) * 2, 3)))
    store = Store.open!(cut)

    {pictures, error} =
      try do
        {got(store, "Video"), nil}
      rescue
        error in Situ.Error -> {store |> Store.messages("Video") |> Enum.take(20), error}
      end

    assert length(pictures) >= 20
    assert error == nil or error.code == :damaged_media

    junk = Path.join(root, "junk.mp4")
    File.write!(junk, :crypto.strong_rand_bytes(5_000))
    assert {:error, %{code: :unreadable_media}} = Store.open(junk)

    File.write!(cut, bytes)
    assert {:error, %{code: :changed}} = Store.at(store, "Video", 10)
  end

  test "a corrupted file is an error or a recording, never a crash", %{tmp_dir: root} do
    bytes = File.read!(mp4(root))
    :rand.seed(:exsss, {1, 2, 3})
    broken = Path.join(root, "broken.mp4")

    for _ <- 1..8 do
      hits =
        for _ <- 1..20,
            into: %{},
            do: {:rand.uniform(byte_size(bytes)) - 1, :rand.uniform(256) - 1}

      # The index of an MP4 is in its last kilobytes, so half of the changes go there.
      tail =
        for _ <- 1..10,
            into: hits,
            do: {byte_size(bytes) - :rand.uniform(3_000), :rand.uniform(256) - 1}

      File.write!(
        broken,
        for(
          {b, i} <- Enum.with_index(:binary.bin_to_list(bytes)),
          into: <<>>,
          do: <<Map.get(tail, i, b)>>
        )
      )

      # The file system sees the same size and modification second for this different file.
      File.touch!(broken, 1_767_225_600)

      case Store.open(broken) do
        {:error, error} ->
          assert error.code in [:unreadable_media, :damaged_media]

        {:ok, store} ->
          for %{name: name} = info <- Store.streams(store) do
            assert info.count <= 1_000
            assert {status, _} = Store.read(store, name, limit: 70)
            assert status in [:ok, :error]
          end
      end
    end
  end

  test "parses a packet list cut into any chunks, with invalid lines" do
    alias Situ.Media.Recording.Packets

    list =
      "packet,0,512,0,512,100,48,K_,adler32:0000000f\npacket,1,-1024,-1024,1024,7,148,KD,side_data,\n\n" <>
        "packet,0,N/A,512,512,9,N/A,__\npacket,1,0,0,1024,8,155,K_\npacket,9,x\nstream,0,1/12800\n" <>
        "stream,1,0/0\nformat,0.040000\npacket,0,99999999999999999999999999,0,1,1,9,__,adler32:1\n"

    whole = Packets.feed(Packets.new(0, 1), list)
    assert whole.pictures == [{0, false}, {512, false}, {512, true}]
    assert {whole.vague?, whole.sound_end, whole.zero} == {true, 1024, 40_000}

    assert {whole.bases, whole.picture_bytes, whole.sound_bytes} ==
             {%{"0" => {1, 12_800}}, 110, 15}

    for n <- 1..40 do
      parts = for <<part::binary-size(n) <- list>>, do: part
      rest = binary_part(list, length(parts) * n, byte_size(list) - length(parts) * n)
      assert Enum.reduce(parts ++ [rest], Packets.new(0, 1), &Packets.feed(&2, &1)) == whole
    end
  end

  test "the processes of a file end when idle and restart on demand", %{tmp_dir: root} do
    store = Store.open!(mp4(root))
    {:ok, first} = Store.at(store, "Video", 0)
    key = {Recording.Images, store.state.path, store.state.version, store.state.print}
    [{pid, _}] = Registry.lookup(Recording.Registry, key)
    ref = Process.monitor(pid)
    send(pid, :timeout)
    assert_receive {:DOWN, ^ref, :process, ^pid, :normal}
    assert Store.at(store, "Video", 0) == {:ok, first}
  end
end
