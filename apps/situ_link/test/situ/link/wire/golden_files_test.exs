defmodule Situ.Link.Wire.GoldenFilesTest do
  # Decodes the frames of test/golden, which every later version must be able to decode.
  use ExUnit.Case, async: true
  alias Situ.Link.Wire.Frame

  @root Path.expand("../../../../../../test/golden", __DIR__)
  Code.require_file("values.exs", @root)

  for file <- Path.wildcard(Path.join(@root, "*/link_frames.json")) do
    {:ok, frames} = file |> File.read!() |> Situ.JSON.decode()

    for %{"bytes" => hex, "frame" => [kind | _] = values} <- frames do
      test "#{Path.basename(Path.dirname(file))}: #{kind} decodes to its values" do
        assert {:ok, frame} = unquote(hex) |> Base.decode16!() |> Frame.decode()
        assert Situ.GoldenValues.to_json(frame) == unquote(Macro.escape(values))
        assert frame |> Frame.encode() |> IO.iodata_to_binary() |> Frame.decode() == {:ok, frame}
      end
    end
  end
end
