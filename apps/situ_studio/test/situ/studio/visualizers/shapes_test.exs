defmodule Situ.Studio.Visualizers.ShapesTest do
  # Draws the trails of shapes over images.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking
  alias Situ.{Point2, Rect}

  @s 1_000_000_000

  defp shown(props) do
    session = session()
    box = &%Rect{x: &1, y: 0, width: 10, height: 20, id: 3}
    put(session, "seen", for(i <- 0..9, do: {i * @s, [box.(i * 100), %Point2{x: i, y: 5}]}))
    spec = %{"stream" => "seen", "viz" => "shapes", "props" => props}
    asked = %{"open" => [[1, spec]], "at" => Integer.to_string(9 * @s), "instant" => [1]}
    {%{frames: [frame]}, _} = ask(session, asked)
    json(frame.payload)
  end

  test "draws a trail of seconds before the message, fading with age" do
    assert [[1.0, [[605.0, 10.0, 3], [6, 5, nil]], []], [0.667, _, []], [0.333, _, []]] =
             shown(%{"trail" => 3})["trail"]

    refute Map.has_key?(shown(%{}), "trail")
    refute Map.has_key?(shown(%{"trail" => "long"}), "trail")
  end
end
