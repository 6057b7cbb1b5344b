defmodule Situ.MediaTest do
  use ExUnit.Case, async: true

  import Situ.Media.TestFiles, only: [path: 1]
  import Situ.Media.TestPipelines
  alias Situ.{AudioBuffer, Image}

  test "opens a file, a simulated device and a test image by name" do
    talk = path("talk1.mp4")
    {{:ok, _}, %{video: video}} = collect(&Situ.Media.open(&1, talk, size: {32, 16}))
    assert length(video) == 350

    got =
      collect_live(&Situ.Media.open(&1, "simulated:" <> talk, size: {32, 16}), video: 3, audio: 3)

    assert [{_, _, %Image{width: 32}} | _] = got.video
    assert [{_, _, %AudioBuffer{}} | _] = got.audio

    picture = "lavfi:testsrc=size=32x16:rate=50"

    %{video: [{_, _, image} | _]} =
      collect_live(
        &Map.delete(Situ.Media.open(&1, picture, size: nil, microphone: nil), :audio),
        video: 3
      )

    assert {image.width, image.height} == {32, 16}
  end

  test "a missing source is an error" do
    assert {:error, %{code: :no_file}} = Situ.Pipeline.run(&Situ.Media.open(&1, "absent.mp4"))
  end
end
