defmodule Situ.Media.Recording.CodedImagesTest do
  use ExUnit.Case, async: true
  alias Situ.Media.Recording.{CodecName, PacketPlaces}
  alias Situ.Media.TestFiles
  alias Situ.Recording.CodedVideo
  alias Situ.Store

  doctest CodecName
  doctest PacketPlaces

  @moduletag :tmp_dir

  # A film of 25 images per second with a key frame every 20 images.
  defp film(folder, name, args) do
    path = Path.join(folder, name)
    source = ~w(-f lavfi -i testsrc2=size=64x48:rate=25:duration=2)
    TestFiles.ffmpeg!(source ++ ~w(-pix_fmt yuv420p -g 20) ++ args ++ [path])
    path
  end

  defp open_video(path) do
    store = Store.open!(path)
    {:ok, info} = Store.stream_info(store, "Video")
    {store, info, CodedVideo.fetch(store, info)}
  end

  # The packets as FFmpeg copies them, one after the other.
  defp copied_bytes(path, folder) do
    out = Path.join(folder, "packets")
    TestFiles.ffmpeg!(~w(-i #{path} -map 0:v -c copy -f data #{out}))
    File.read!(out)
  end

  for {name, args, codec} <- [
        {"b.mp4", ~w(-c:v libx264 -bf 3), "avc1."},
        {"b.mkv", ~w(-c:v libx264 -bf 3), "avc1."},
        {"v.webm", ~w(-c:v libvpx-vp9 -deadline realtime -cpu-used 8), "vp09.00."},
        {"v8.webm", ~w(-c:v libvpx -deadline realtime), "vp8"},
        {"m.avi", ~w(-c:v mjpeg), "jpeg"},
        {"m.mov", ~w(-c:v mjpeg), "jpeg"}
      ] do
    test "the packets of #{name} are those of FFmpeg, at the times of the images", %{
      tmp_dir: root
    } do
      path = film(root, unquote(name), unquote(args))
      {store, info, {:ok, video}} = open_video(path)
      assert String.starts_with?(video.codec, unquote(codec))
      assert {video.width, video.height, video.rotation} == {64, 48, 0}

      packets = CodedVideo.list_packets(video)
      assert length(packets) == 50
      {:ok, messages} = Store.read(store, info, envelopes: true)

      assert packets |> Enum.map(&elem(&1, 0)) |> Enum.sort() ==
               Enum.map(messages, & &1.originating_time)

      assert match?([{_, _, true} | _], packets)
      {:ok, bytes} = CodedVideo.read_packets(store, info, 0, 50)
      assert Enum.map(bytes, &byte_size/1) == Enum.map(packets, &elem(&1, 1))

      # FFmpeg writes no headers of its own into a copy of these codecs.
      if unquote(codec) != "jpeg",
        do: assert(IO.iodata_to_binary(bytes) == copied_bytes(path, root))

      {:ok, [middle]} = CodedVideo.read_packets(store, info, 7, 1)
      assert middle == Enum.at(bytes, 7)
    end
  end

  test "images before the start of an edit list are decoded, but not shown", %{tmp_dir: root} do
    path = film(root, "whole.mp4", ~w(-c:v libx264 -bf 2))
    cut = Path.join(root, "cut.mp4")
    # 0.8 s is a key frame, and 1.3 s is not.
    TestFiles.ffmpeg!(~w(-ss 1.3 -i #{path} -c copy #{cut}))
    {store, info, {:ok, video}} = open_video(cut)
    packets = CodedVideo.list_packets(video)
    shown = for {time, _, _} <- packets, time != :hidden, do: time
    assert length(shown) < length(packets)
    {:ok, messages} = Store.read(store, info, envelopes: true)
    assert Enum.sort(shown) == Enum.map(messages, & &1.originating_time)
    assert match?([{:hidden, _, true} | _], packets)
  end

  test "the color matrix is nil unless the video states it", %{tmp_dir: root} do
    x264 = ~w(-c:v libx264 -preset ultrafast)
    {_, _, {:ok, unstated}} = open_video(film(root, "unstated.mp4", x264))
    {_, _, {:ok, stated}} = open_video(film(root, "stated.mp4", x264 ++ ~w(-colorspace bt709)))
    assert {unstated.color, stated.color} == {nil, "bt709"}
  end

  test "the rotation of a video is that of its images", %{tmp_dir: root} do
    path = film(root, "plain.mp4", ~w(-c:v libx264))
    turned = Path.join(root, "turned.mp4")
    TestFiles.ffmpeg!(~w(-i #{path} -c copy -metadata:s:v rotate=90 #{turned}))
    {store, info, found} = open_video(turned)

    # FFmpeg since version 6 has another option for it, and then does not turn the file.
    with {:ok, %{rotation: rotation}} when rotation != 0 <- found do
      assert {:ok, %{data: %{width: 48, height: 64}}} = Store.at(store, info, 0)
      assert rotation in [90, 270]
    end
  end

  test "codecs that no browser decodes are left to the server", %{tmp_dir: root} do
    {_, _, {:error, error}} = root |> film("old.avi", ~w(-c:v mpeg4)) |> open_video()
    assert {error.code, error.why} == {:not_coded, "no browser decodes mpeg4"}
    assert error.what =~ "old.avi"
  end

  test "files that do not state the places of packets are left to the server", %{tmp_dir: root} do
    {_, _, {:error, error}} = root |> film("t.m2ts", ~w(-c:v libx264 -f mpegts)) |> open_video()
    assert error.code == :not_coded
  end

  test "audio has no images", %{tmp_dir: root} do
    path = Path.join(root, "tone.mka")
    TestFiles.ffmpeg!(~w(-f lavfi -i sine=duration=1 #{path}))
    store = Store.open!(path)
    {:ok, info} = Store.stream_info(store, "Audio")
    assert CodedVideo.fetch(store, info) == :none
  end

  test "bytes that changed since the index was made are noticed", %{tmp_dir: root} do
    path = film(root, "changed.mp4", ~w(-c:v libx264))
    {store, info, {:ok, video}} = open_video(path)
    {:ok, [first]} = CodedVideo.read_packets(store, info, 0, 1)
    stat = File.stat!(path, time: :posix)
    content = File.read!(path)
    [{at, size}] = :binary.matches(content, first)
    middle = at + div(size, 2)
    <<before::binary-size(middle), byte, rest::binary>> = content
    File.write!(path, [before, Bitwise.bxor(byte, 255), rest])
    # The size and the second of the modification are the same.
    File.touch!(path, stat.mtime)
    {:error, error} = CodedVideo.read_packets(store, info, 0, 1)
    assert error.code == :damaged_media
    assert {:ok, [_]} = CodedVideo.read_packets(store, info, 1, 1)

    File.write!(path, "another file")
    assert {:error, %{code: :changed}} = CodedVideo.read_packets(store, info, 1, 1)
    assert CodedVideo.packet_count(video) == 50
  end

  test "packets that do not exist are refused", %{tmp_dir: root} do
    {store, info, {:ok, _}} = root |> film("short.mp4", ~w(-c:v libx264)) |> open_video()
    assert {:error, %{code: :bad_option}} = CodedVideo.read_packets(store, info, 45, 6)
    assert {:error, %{code: :bad_option}} = CodedVideo.read_packets(store, info, 90, 1)
    assert {:ok, []} = CodedVideo.read_packets(store, info, 50, 0)
  end

  test "a truncated file offers the packets that it still has", %{tmp_dir: root} do
    path = film(root, "long.mkv", ~w(-c:v libx264))
    cut = Path.join(root, "short.mkv")
    content = File.read!(path)
    File.write!(cut, binary_part(content, 0, div(byte_size(content) * 2, 3)))
    {store, info, {:ok, video}} = open_video(cut)
    count = CodedVideo.packet_count(video)
    assert count in 10..49
    assert {:ok, packets} = CodedVideo.read_packets(store, info, 0, count - 1)
    assert length(packets) == count - 1
  end
end
