defmodule Situ.Studio.Draw.NearTest do
  # The cursor shows the last message, or a message that is near enough on either side.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking
  @second 1_000_000_000

  defp shown(seconds, props) do
    session = session()
    put(session, "said", [{10 * @second, "a"}, {12 * @second, "b"}])
    spec = %{"stream" => "said", "viz" => "text", "props" => props}
    at = Integer.to_string(round(seconds * @second))
    {%{frames: [frame]}, _} = ask(session, %{"open" => [[1, spec]], "at" => at, "instant" => [1]})
    if frame.kind == 5, do: json(frame.payload)["text"]
  end

  test "without a limit, a message holds until the next one" do
    assert for(t <- [9, 10, 11.9, 12, 900], do: shown(t, %{})) == [nil, "a", "a", "b", "b"]
  end

  test "with a limit, a message holds that long" do
    near = %{"past" => 0.5}
    assert for(t <- [9.9, 10, 10.5, 10.51, 13], do: shown(t, near)) == [nil, "a", "a", nil, nil]
  end

  test "takes the nearer message within its limit, else the farther one within its limit" do
    near = %{"past" => 1.5, "future" => 0.3}
    times = [9.6, 9.7, 11.4, 11.5, 11.6, 11.8]
    assert for(t <- times, do: shown(t, near)) == [nil, "a", "a", "a", nil, "b"]
    assert shown(11.2, %{"past" => 1.5, "future" => 1}) == "b"
    assert shown(11.2, %{"past" => "much", "future" => -1}) == "a"
  end
end
