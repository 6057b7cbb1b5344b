defmodule Situ.Media.SmallCopiesTest do
  use ExUnit.Case, async: true

  import Situ.Media.TestFiles, only: [path: 1, ffmpeg!: 1]
  import Situ.Test.Eventually
  alias Situ.Media.SmallCopies
  alias Situ.Recording.CodedVideo
  alias Situ.{Store, Time}

  @moduletag :tmp_dir

  defp start_copies(root, opts \\ []) do
    name = :"#{__MODULE__}.#{System.unique_integer([:positive])}"

    start_supervised!({SmallCopies, [name: name, root: Path.join(root, "cache")] ++ opts},
      id: name
    )

    name
  end

  defp await_copy(film, copies) do
    eventually(fn -> SmallCopies.fetch(film.state, copies) != :pending end)
    SmallCopies.fetch(film.state, copies)
  end

  test "a copy has small key frames with the times of the file's images", %{tmp_dir: root} do
    copies = start_copies(root)
    film = Store.open!(path("talk1.mp4"))
    assert SmallCopies.fetch(film.state, copies) == :pending
    assert {:ok, copy} = await_copy(film, copies)

    {:ok, info} = Store.stream_info(copy, "Video")

    assert {:ok, %CodedVideo{codec: "avc1." <> _, width: 320, height: 160} = video} =
             CodedVideo.fetch(copy, info)

    rows = CodedVideo.list_packets(video)
    assert Enum.all?(rows, fn {_, _, key?} -> key? end)
    # The file has 25 images per second.
    assert for({time, _, _} <- rows, do: time) == for(i <- 0..116, do: 3 * i * Time.ms(40))
    assert {:ok, %{data: %Situ.Image{width: 320}}} = Store.at(copy, "Video", 50)

    # Another server finds it in the same folder.
    again = start_copies(root)
    assert {:ok, _} = SmallCopies.fetch(film.state, again)
  end

  test "the copy of a turned film is turned", %{tmp_dir: root} do
    film = Path.join(root, "turned.mp4")

    ffmpeg!(["-i", path("talk1.mp4"), "-t", "1", "-c", "copy", "-metadata:s:v", "rotate=90", film])

    assert {:ok, copy} = await_copy(Store.open!(film), start_copies(root))
    assert {:ok, %{data: %Situ.Image{width: 160, height: 320}}} = Store.at(copy, "Video", 0)
  end

  test "old copies make room for new ones", %{tmp_dir: root} do
    copies = start_copies(root, most_bytes: 1)

    for name <- ["a.mp4", "b.mp4"] do
      film = Path.join(root, name)
      ffmpeg!(["-i", path("talk1.mp4"), "-t", "1", "-c", "copy", "-an", film])
      assert {:ok, _} = await_copy(Store.open!(film), copies)
    end

    assert [_newest] = File.ls!(Path.join(root, "cache"))
  end

  test "a file without images has no copy", %{tmp_dir: root} do
    film = Path.join(root, "sound.m4a")
    ffmpeg!(["-i", path("talk1.mp4"), "-t", "1", "-vn", "-c", "copy", film])
    assert SmallCopies.fetch(Store.open!(film).state, start_copies(root)) == :none
  end
end
