defmodule PythonModelTest do
  use ExUnit.Case, async: true
  alias PythonModel.Gate
  alias Situ.Time

  # In the clip, a person speaks from 0.8 to 7.3 s, and does not move afterwards.
  @tag timeout: 300_000
  test "the camera is recorded while the person moves" do
    streams = ["Motion", "Where", "Camera"]
    {:ok, outputs} = Situ.Test.run_pipeline(PythonModel, streams, python: python())
    assert length(outputs["Motion"]) == 288
    recorded = for {time, %Situ.EncodedImage{}} <- outputs["Camera"], do: Time.to_seconds(time)
    assert_in_delta hd(recorded), 0.9, 0.2
    assert_in_delta List.last(recorded), 8.5, 0.5

    # What moves is the mouth, which is at 260, 300 in the image of 512 x 512 pixels.
    {_, [rect]} = Enum.find(outputs["Where"], fn {time, _} -> time > Time.s(2) end)
    assert Situ.Rect.contains_point?(rect, %Situ.Point2{x: 260, y: 300}) and rect.width < 300
  end

  test "the gate stays open for a while" do
    shares = for i <- 0..9, do: {Time.ms(100 * i), if(i in 2..3, do: 0.5, else: 0.0)}
    gate = &Situ.via(&1.shares, Gate, above: 0.1, hold: Time.ms(200))
    {:ok, open} = Situ.Test.run([shares: shares], gate)
    assert for({time, true} <- open, do: div(time, 100_000_000)) == [2, 3, 4, 5]
  end

  # Another interpreter than the first one in PATH, such as a virtual environment.
  defp python, do: System.get_env("PYTHON", "python3")
end
