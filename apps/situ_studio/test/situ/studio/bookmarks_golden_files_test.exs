defmodule Situ.Studio.BookmarksGoldenFilesTest do
  # Reads the bookmarks of test/golden, which every later version must be able to read.
  use ExUnit.Case, async: true

  @files Path.wildcard(Path.expand("../../../../../test/golden/*/study.bookmarks", __DIR__))

  test "there are golden bookmarks" do
    assert @files != []
  end

  for file <- @files do
    test "#{Path.basename(Path.dirname(file))}: the bookmark has its times, text and author" do
      assert {:ok, [bookmark]} = Situ.Studio.Bookmarks.read(unquote(file))

      assert %{from: 1_700_000_000_000_000_000, to: 1_700_000_000_000_000_005} = bookmark
      assert %{text: "look here", by: "ada"} = bookmark
    end
  end
end
