defmodule LobbyRobotTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias LobbyRobot.Greeter
  alias Situ.Time

  @tag timeout: 300_000
  test "greets the two people of the clip, who look at the camera all the time" do
    capture_io(fn ->
      {:ok, outputs} = Situ.Test.run_pipeline(LobbyRobot, ["Greeting", "Looking", "Voice"])
      assert [{_, "Hello! I am" <> _}] = outputs["Greeting"]
      assert outputs["Looking"] |> List.last() |> elem(1) == %{0 => true, 1 => true}
      # The voice has been synthesized, and says twelve words.
      assert [{_, %Situ.AudioBuffer{} = voice}] = outputs["Voice"]
      assert Situ.AudioBuffer.duration_ns(voice) in Time.s(2)..Time.s(8)
    end)
  end

  test "a person who looks only briefly is not greeted" do
    assert greetings([{0, [1]}, {300, [1]}, {600, []}, {1500, [1]}, {2000, []}]) == []
  end

  test "a person is greeted once per visit, and the next person differently" do
    looks = for ms <- 0..3000//100, do: {ms, if(ms < 1500, do: [1], else: [1, 2])}
    again = for ms <- 40_000..41_000//100, do: {ms, [1]}

    assert [{800, "Hello! I" <> _}, {2300, "Hello to you" <> _}, {40_800, _}] =
             greetings(looks ++ again)
  end

  defp greetings(looks) do
    looking = for {ms, ids} <- looks, do: {Time.ms(ms), Map.new(ids, &{&1, true})}
    {:ok, greetings} = Situ.Test.run([looking: looking], &Situ.via(&1.looking, Greeter))
    for {time, text} <- greetings, do: {div(time, 1_000_000), text}
  end
end
