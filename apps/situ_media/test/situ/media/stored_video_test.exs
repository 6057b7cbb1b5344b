defmodule Situ.Media.StoredVideoTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog
  alias Situ.{Image, ImageOps, Message, Pipeline, Store, Time, VideoPacket}
  alias Situ.Media.StoredVideo.EncoderOptions
  alias Situ.Recording.CodedVideo
  alias Situ.Store.{Undecoded, Writer}

  doctest Situ.Media.StoredVideo.EncoderOptions

  @moduletag :tmp_dir
  @step 33_333_333

  # A bright square whose position tells the number of the image.
  defp picture(i, {width, height, format} \\ {96, 64, :bgr24}) do
    Image.new_filled(width, height, format, 40)
    |> ImageOps.fill_rectangle!({rem(i * 4, width - 16), 8, 16, 16}, color: 220)
  end

  defp record(root, images, opts \\ [], create \\ []) do
    run = fn p ->
      store = Store.create(p, "cam", root, create)

      p
      |> Situ.from_enumerable(images, every: @step)
      |> Situ.map(& &1, type: Image)
      |> Store.write(store, "Camera", Keyword.merge([encode: :h264], opts))
    end

    Pipeline.run(run, pipeline: [replay: [interval: {1_000, :unbounded}, speed: :max]])
  end

  defp open_recording(root), do: Store.open!(Path.join(root, "cam"))
  defp packets(store), do: store |> Store.messages("Camera", packets: true) |> Enum.to_list()
  defp positions(store), do: Enum.map(packets(store), & &1.data.position)

  defp distance(image, other) do
    {:ok, %{mean: mean}} = ImageOps.compare(image, other)
    mean
  end

  test "images come back with their times and sequence ids", %{tmp_dir: root} do
    images = Enum.map(0..49, &picture/1)
    assert {:ok, _} = record(root, images, encode: {:h264, keyframe_every: Time.ms(500)})
    store = open_recording(root)
    assert {:ok, %{type: Image, count: 50}} = Store.stream_info(store, "Camera")

    read = store |> Store.messages("Camera") |> Enum.to_list()
    assert Enum.map(read, & &1.originating_time) == for(i <- 0..49, do: 1_000 + i * @step)
    assert Enum.map(read, & &1.sequence_id) == Enum.to_list(1..50)
    assert Enum.all?(Enum.zip(read, images), fn {m, image} -> distance(m.data, image) < 2 end)

    assert positions(store) |> Enum.chunk_every(16) |> Enum.map(&hd/1) |> Enum.uniq() == [0]
    assert %{size: size} = elem(Store.stream_info(store, "Camera"), 1)
    assert size < 50 * 96 * 64 * 3 / 10
  end

  test "every way to an image gives the same pixels", %{tmp_dir: root} do
    {:ok, _} =
      record(root, Enum.map(0..39, &picture/1), encode: {:h264, keyframe_every: Time.ms(500)})

    in_order = open_recording(root) |> Store.messages("Camera") |> Enum.map(& &1.data)

    for i <- Enum.take_random(0..39, 10) do
      # Each store that is opened has its own messages, and all share the decoders.
      store = open_recording(root)
      assert {:ok, %Message{data: image}} = Store.at(store, "Camera", i)
      assert image == Enum.at(in_order, i)
      assert {:ok, %Message{data: ^image}} = Store.latest_at(store, "Camera", 1_000 + i * @step)
    end
  end

  test "gray images and odd sizes keep their format and size", %{tmp_dir: root} do
    for {{width, height, format} = shape, n} <-
          Enum.with_index([{97, 65, :bgr24}, {64, 33, :gray8}, {33, 64, :rgb24}]) do
      folder = Path.join(root, "#{n}")
      images = Enum.map(0..4, &picture(&1, shape))
      assert {:ok, _} = record(folder, images)
      read = folder |> open_recording() |> Store.messages("Camera") |> Enum.map(& &1.data)
      assert [%Image{width: ^width, height: ^height, format: ^format} | _] = read
      assert Enum.all?(Enum.zip(read, images), fn {a, b} -> distance(a, b) < 2 end)
    end
  end

  test "another size in the middle begins with a key frame", %{tmp_dir: root} do
    images = Enum.map(0..9, &picture/1) ++ Enum.map(0..9, &picture(&1, {48, 48, :bgr24}))
    {:ok, _} = record(root, images)
    store = open_recording(root)
    assert positions(store) == Enum.concat(0..9, 0..9)
    read = store |> Store.messages("Camera") |> Enum.map(& &1.data)
    assert Enum.map(read, & &1.width) == List.duplicate(96, 10) ++ List.duplicate(48, 10)
    assert Enum.all?(Enum.zip(read, images), fn {a, b} -> distance(a, b) < 2.5 end)
  end

  test "VP8 and VP9 are stored, too", %{tmp_dir: root} do
    for codec <- [:vp8, :vp9] do
      folder = Path.join(root, "#{codec}")
      images = Enum.map(0..9, &picture/1)
      {:ok, _} = record(folder, images, encode: codec)
      store = open_recording(folder)
      assert Enum.all?(packets(store), &(&1.data.codec == codec))
      read = store |> Store.messages("Camera") |> Enum.map(& &1.data)
      assert Enum.all?(Enum.zip(read, images), fn {a, b} -> distance(a, b) < 3 end)
    end
  end

  test "images that a video cannot hold are refused with a way out", %{tmp_dir: root} do
    images = [Image.new_filled(16, 16, :gray16, 40_000)]
    {{:error, error}, _log} = with_log(fn -> record(root, images) end)
    assert Exception.message(error) =~ "gray16"

    assert {:error, error} = record(root, images, encode: :h266)
    assert Exception.message(error) =~ "is not a video codec"
    assert {:error, error} = record(root, images, encode: {:h264, quality: 99})
    assert Exception.message(error) =~ "quality"
  end

  test "a copy begins with a key frame and is not encoded again", %{tmp_dir: root} do
    {:ok, _} =
      record(root, Enum.map(0..39, &picture/1), encode: {:h264, keyframe_every: Time.ms(500)})

    store = open_recording(root)
    [_, second | _] = for {m, i} <- Enum.with_index(packets(store)), m.data.position == 0, do: i
    from = 1_000 + (second + 5) * @step
    {:ok, path} = Store.crop(store.path, {"part", root}, from: from)
    part = Store.open!(path)

    assert packets(part) |> Enum.map(& &1.data) ==
             store |> packets() |> Enum.drop(second) |> Enum.map(& &1.data)

    whole = store |> Store.messages("Camera") |> Enum.drop(second) |> Enum.map(& &1.data)
    assert part |> Store.messages("Camera") |> Enum.map(& &1.data) == whole
    assert {:ok, %{damage: []}} = Store.verify(path)

    {:ok, path} = Store.compact(path)
    assert path |> Store.open!() |> Store.messages("Camera") |> Enum.map(& &1.data) == whole

    assert {:error, %{code: :not_editable}} =
             Store.edit(path, {"edited", root}, %{"Camera" => [{:delete, from}]})
  end

  test "without their key frame, images say why they cannot be decoded", %{tmp_dir: root} do
    {:ok, _} =
      record(root, Enum.map(0..19, &picture/1), encode: {:h264, keyframe_every: Time.ms(300)})

    [_ | rest] = root |> open_recording() |> packets()
    {:ok, writer} = Writer.create("cut", root)
    {:ok, stream} = Writer.stream(writer, "Camera", type: Image)
    {:ok, stream} = Writer.append(stream, rest)
    {:ok, _} = Writer.close_stream(stream, List.last(rest).originating_time)
    :ok = Writer.close(writer)

    {lost, there} =
      writer.path
      |> Store.open!()
      |> Store.messages("Camera")
      |> Enum.map(& &1.data)
      |> Enum.split_while(&is_struct(&1, Undecoded))

    assert length(lost) == Enum.find_index(rest, &VideoPacket.key?(&1.data))
    assert hd(lost).reason =~ "key frame"
    assert [_ | _] = there
    assert Enum.all?(there, &is_struct(&1, Image))
  end

  test "segments begin with a key frame", %{tmp_dir: root} do
    {:ok, _} =
      record(root, Enum.map(0..59, &picture/1), [encode: {:h264, keyframe_every: Time.ms(300)}],
        split: Time.ms(500)
      )

    segments = Store.list(root, segments: true)
    assert length(segments) >= 3

    for path <- segments, do: assert([0 | _] = path |> Store.open!() |> positions())
    whole = open_recording(root)
    images = whole |> Store.messages("Camera") |> Enum.map(& &1.data)
    assert length(images) == 60 and Enum.all?(images, &is_struct(&1, Image))
    assert {:ok, %Message{data: last}} = Store.at(whole, "Camera", -1)
    assert last == List.last(images)
    # Through the segment alone, the image is the same.
    assert {:ok, %Message{data: ^last}} =
             segments |> List.last() |> Store.open!() |> Store.at("Camera", -1)
  end

  test "packets are described for programs that decode them", %{tmp_dir: root} do
    {:ok, _} = record(root, Enum.map(0..19, &picture/1))
    store = open_recording(root)
    {:ok, info} = Store.stream_info(store, "Camera")

    assert {:ok, %CodedVideo{codec: "avc1." <> _, description: ""} = video} =
             CodedVideo.fetch(store, info)

    stored = packets(store)

    assert CodedVideo.list_packets(video) ==
             for(
               m <- stored,
               do: {m.originating_time, byte_size(m.data.data), m.data.position == 0}
             )

    assert {:ok, bytes} = CodedVideo.read_packets(store, info, 3, 5)
    assert bytes == stored |> Enum.slice(3, 5) |> Enum.map(& &1.data.data)
    assert {:error, %{code: :bad_option}} = CodedVideo.read_packets(store, info, 18, 5)
  end

  test "packets become a video file without being encoded again", %{tmp_dir: root} do
    {:ok, _} =
      record(root, Enum.map(0..39, &picture/1), encode: {:h264, keyframe_every: Time.ms(500)})

    store = open_recording(root)
    images = store |> Store.messages("Camera") |> Enum.map(& &1.data)

    for name <- ["cam.mp4", "cam.mkv"] do
      path = Path.join(root, name)
      assert {:ok, 40} = Situ.Media.copy_video(store, "Camera", path)
      film = Store.open!(path)
      assert {:ok, %{count: 40, first: first}} = Store.stream_info(film, "Video")
      assert first == 1_000
      assert {:ok, %Message{data: image}} = Store.at(film, "Video", 33)
      assert distance(image, Enum.at(images, 33)) < 1
      {:ok, info} = Store.stream_info(film, "Video")
      {:ok, video} = CodedVideo.fetch(film, info)
      keys = for {_, _, key?} <- CodedVideo.list_packets(video), do: key?
      assert keys == Enum.map(packets(store), &VideoPacket.key?(&1.data))
    end

    path = Path.join(root, "part.mp4")

    assert {:ok, 10} =
             Situ.Media.copy_video(store, "Camera", path,
               from: 1_000 + 20 * @step,
               to: 1_000 + 25 * @step
             )

    assert {:error, %{code: :bad_option}} =
             Situ.Media.copy_video(store, "Camera", Path.join(root, "cam.avi"))
  end

  test "everything that is acknowledged survives a kill", %{tmp_dir: root} do
    script = """
    Logger.configure(level: :error)
    {:ok, _} = Application.ensure_all_started(:situ_media)
    Situ.Pipeline.start(fn p ->
      store = Situ.Store.create(p, "cam", #{inspect(root)})
      p
      |> Situ.repeat(Situ.Image.new_filled(64, 48, :bgr24, [10, 90, 200]), every: 5_000_000)
      |> Situ.Store.write(store, "Camera", encode: {:h264, keyframe_every: 300_000_000})
    end)
    Process.sleep(:infinity)
    """

    paths =
      for path <- :code.get_path(), text = to_string(path), text =~ "/_build/", do: ["-pa", text]

    args = List.flatten(paths) ++ ["-e", script]
    port = Port.open({:spawn_executable, System.find_executable("elixir")}, [:binary, args: args])
    {:os_pid, pid} = Port.info(port, :os_pid)
    path = Path.join(root, "cam.0000")
    known = await_messages(path, 100)
    {_, 0} = System.cmd("kill", ["-9", "#{pid}"])
    store = Store.open!(path)
    images = store |> Store.messages("Camera") |> Enum.map(& &1.data)
    assert length(images) >= known
    assert Enum.all?(images, &match?(%Image{width: 64}, &1))
  end

  # Returns the number of messages that another process has committed, as soon as there are `least`.
  defp await_messages(path, least) do
    count =
      case Store.open(path) do
        {:ok, store} ->
          if Store.has_stream?(store, "Camera"), do: Store.count(store, "Camera"), else: 0

        {:error, _} ->
          0
      end

    if count >= least, do: count, else: await_messages(path, least)
  end

  test "an encoder is chosen, or the error says what to install" do
    assert EncoderOptions.choose_encoder(:h264, ["libx264", "libvpx"]) ==
             {:ok, {:h264, "libx264"}}

    assert EncoderOptions.choose_encoder(:h264, ["libvpx-vp9"]) == {:ok, {:vp9, "libvpx-vp9"}}
    assert {:error, %{code: :no_encoder, fix: fix}} = EncoderOptions.choose_encoder(:h264, [])
    assert fix =~ "apt-get"
  end
end
