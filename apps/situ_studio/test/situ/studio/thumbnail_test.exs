defmodule Situ.Studio.ThumbnailTest do
  use ExUnit.Case, async: true

  alias Situ.Studio.{History, Source, Thumbnail}

  test "one number alone is a level line, and a stream of nothing has no picture" do
    one = History.new(live: false)
    message = %Situ.Message{data: 1.5, originating_time: 5, creation_time: 5, sequence_id: 0}
    History.put(one, "Only", message, 8)

    assert {:ok, "image/svg+xml", svg} = Thumbnail.of({Source.History, one})
    assert IO.iodata_to_binary(svg) =~ "M0.0 86.0L160.0 86.0"
    assert Thumbnail.of({Source.History, History.new(live: false)}) == :none
  end
end
