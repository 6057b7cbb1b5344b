defmodule Situ.Infer.ImageServiceTest do
  use ExUnit.Case, async: true
  alias Situ.{Image, Rect}
  alias Situ.Infer.ImageService
  alias Situ.Infer.Test.ChatServer

  @seen %{
    captionResult: %{text: "a cup on a table", confidence: 0.8},
    tagsResult: %{values: [%{name: "cup", confidence: 0.99}, %{name: 3, confidence: 1}]},
    objectsResult: %{
      values: [
        %{boundingBox: %{x: 1, y: 2, w: 30, h: 40}, tags: [%{name: "cup", confidence: 0.7}]},
        %{tags: []}
      ]
    },
    peopleResult: %{values: [%{boundingBox: %{x: 0, y: 0, w: 10, h: -1}, confidence: 0.5}]},
    readResult: %{
      blocks: [
        %{
          lines: [
            %{
              text: "TEA",
              boundingPolygon: [%{x: 5, y: 6}, %{x: 25, y: 7}, %{x: 25, y: 16}, %{x: 5, y: 15}]
            }
          ]
        }
      ]
    }
  }

  defp look(script, opts) do
    server = ChatServer.start(script)

    picture =
      Image.new!(
        width: 64,
        height: 48,
        format: :rgb24,
        data: :binary.copy(<<90, 150, 230>>, 64 * 48)
      )

    opts = [url: server.url, key: nil, backoff: 1] ++ opts

    Situ.to_list(fn p ->
      p |> Situ.from_enumerable([picture], every: 1) |> Situ.via(ImageService, opts)
    end)
  end

  test "sends an image as JPEG and returns names, rectangles and lines" do
    assert [seen] =
             look(fn _, _ -> ChatServer.json(@seen) end, features: [:caption, :objects, :text])

    assert seen.caption == {"a cup on a table", 0.8}
    assert seen.tags == [{"cup", 0.99}]
    assert [%Rect{x: 1, y: 2, width: 30, height: 40, label: "cup", score: 0.7}] = seen.objects
    assert seen.people == []
    assert [%Rect{x: 5, y: 6, width: 20, height: 10, label: "TEA"}] = seen.text
    assert_receive {:request, 1, %{first: first, body: <<0xFF, 0xD8, _::binary>>}}

    assert first =~
             "/computervision/imageanalysis:analyze?api-version=2024-02-01&features=caption%2Cobjects%2Cread"
  end

  test "handles an unexpected response and a refusal" do
    assert_raise Situ.Error, ~r/an unexpected form/, fn ->
      look(fn _, _ -> ChatServer.answer("a/b", "<p>") end, [])
    end

    assert_raise Situ.Error, ~r/HTTP 400/, fn ->
      look(fn _, _ -> ChatServer.refuse(400, "too small") end, [])
    end

    assert look(fn _, _ -> ChatServer.refuse(400, "too small") end, on_error: :skip) == []

    assert [%{tags: [], objects: [], caption: nil}] =
             look(fn _, _ -> ChatServer.json(%{}) end, [])
  end
end
