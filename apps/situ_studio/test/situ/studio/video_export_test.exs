defmodule Situ.Studio.VideoExportTest do
  # Writes images, audio and overlays with the real encoder, and reads them back.
  use ExUnit.Case, async: true
  doctest Situ.Studio.VideoExport

  alias Situ.{AudioBuffer, AudioFormat, Image, Message, Rect}
  alias Situ.Media.{Decoder, FileInfo}
  alias Situ.Studio.{VideoExport, History, Recordings}

  @ms 1_000_000
  @s 1_000_000_000

  defp source do
    history = History.new(live: false, seconds: 3_600)

    put = fn name, time, data ->
      History.put(history, name, %Message{data: data, originating_time: time}, 8)
    end

    for i <- 0..39,
        do: put.("Camera", i * 100 * @ms, Image.new_filled(64, 48, :rgb24, [20, 40, 60]))

    put.("Faces", 0, [%Rect{x: 10, y: 10, width: 20, height: 20, label: "Ada"}])
    format = AudioFormat.pcm(16_000, 1)
    data = :binary.copy(<<1_000::little-16>>, 8_000)
    for i <- 1..8, do: put.("Mic", i * 500 * @ms, %AudioBuffer{format: format, data: data})
    Recordings.History.wrap(history)
  end

  @tag :tmp_dir
  test "a video is as long as the selection, and has its audio", %{tmp_dir: dir} do
    film = %VideoExport{
      pictures: "Camera",
      from: @s + 50 * @ms,
      to: 3 * @s,
      sound: "Mic",
      over: [{"Faces", 0}]
    }

    path = Path.join(dir, "part.mp4")
    test = self()
    assert :ok = VideoExport.write_video(film, source(), path, &send(test, {:part, &1}))
    assert_received {:part, 0.0}
    assert_received {:part, second} when second > 0.4 and second < 0.6
    {:ok, info} = FileInfo.read(path)
    assert {info.video.width, info.video.height} == {64, 48}
    assert_in_delta info.duration, 1_950 * @ms, 60 * @ms
    assert info.audio
  end

  @tag :tmp_dir
  test "draws masks where the network saw them, and mirrors them with the image", %{
    tmp_dir: dir
  } do
    history = History.new(live: false, seconds: 3_600)

    put = fn name, time, data ->
      History.put(history, name, %Message{data: data, originating_time: time}, 8)
    end

    for i <- 0..9, do: put.("Camera", i * 100 * @ms, Image.new_filled(64, 32, :rgb24, [0, 0, 0]))
    put.("Find.Boxes", 0, [%Rect{x: 0, y: 0, width: 32, height: 32, id: 0}])
    put.("Find.Masks", 0, [Image.new_filled(4, 4, :gray8, [255])])
    masks = [{"Find.Masks", 0, %{"opacity" => 100}}]

    for {flip, bright, dark} <- [{false, 8, 56}, {true, 56, 8}] do
      film = %VideoExport{pictures: "Camera", from: 0, to: @s, masks: masks, flip: flip}
      path = Path.join(dir, "#{flip}.mp4")
      assert :ok = VideoExport.write_video(film, Recordings.History.wrap(history), path, & &1)
      {:ok, decoder} = Decoder.open(path, audio: false)
      assert {:video, _, shown, decoder} = Decoder.next_item(decoder)
      Decoder.close(decoder)
      assert {:ok, [b, _, _]} = Image.fetch_pixel(shown, bright, 16)
      assert {:ok, [b0, _, _]} = Image.fetch_pixel(shown, dark, 16)
      assert b - b0 > 100
    end
  end

  @tag :tmp_dir
  test "returns an error without images", %{tmp_dir: dir} do
    film = %VideoExport{pictures: "Camera", from: 60 * @s, to: 61 * @s}
    history = History.new(live: false)
    source = Recordings.History.wrap(history)

    assert {:error, error} =
             VideoExport.write_video(film, source, Path.join(dir, "part.mp4"), & &1)

    assert error.code in [:no_pictures, :no_stream]
  end
end
