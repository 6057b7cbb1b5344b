defmodule MeetingRoomTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  doctest MeetingRoom.Turns

  # The truth is next to the clip: two people speak, and one voice is outside of the picture.
  @tag :tmp_dir
  @tag timeout: 300_000
  test "the minutes of the clip name the right person for every sentence", %{tmp_dir: folder} do
    minutes = Path.join(folder, "minutes.txt")

    capture_io(fn ->
      {:ok, _} =
        Situ.Pipeline.run(MeetingRoom, minutes: minutes, pipeline: [replay: [speed: :max]])
    end)

    lines = minutes |> File.read!() |> String.split("\n", trim: true)
    assert [first, second, third, fourth] = lines
    assert first =~ "person 0: He might even have been made amiable"
    assert second =~ ~r/person 1: Go forward (ten|10) meters/
    assert third =~ "person 0: "
    assert fourth =~ "outside: "
  end
end
