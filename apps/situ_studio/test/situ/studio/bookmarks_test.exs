defmodule Situ.Studio.BookmarksTest do
  use ExUnit.Case, async: true
  alias Situ.Studio.Bookmarks

  @moduletag :tmp_dir
  @s 1_000_000_000

  defp add(path, from, to, more \\ %{}) do
    times = %{"from" => Integer.to_string(from), "to" => Integer.to_string(to)}
    Bookmarks.edit(path, {:add, Map.merge(times, more)})
  end

  test "are added, changed and deleted, and listed by time", %{tmp_dir: dir} do
    path = Path.join([dir, "new", "walk.bookmarks"])
    assert Bookmarks.read(path) == {:ok, []}
    {:ok, _} = add(path, 7 * @s, 9 * @s, %{"text" => " late ", "by" => "Ada", "list" => "best"})
    {:ok, [first, last]} = add(path, 1_767_225_600_000_000_001, 1_767_225_600_000_000_001)

    assert %{from: 7_000_000_000, to: 9_000_000_000, text: "late", by: "Ada", list: "best"} =
             first

    assert %{from: 1_767_225_600_000_000_001, text: "", by: "", list: ""} = last

    {:ok, _} = Bookmarks.edit(path, {:change, last.id, %{"text" => "here", "by" => "Bob"}})
    assert {:ok, [_, %{text: "here", by: ""}]} = Bookmarks.read(path)
    {:ok, [%{text: "here"}]} = Bookmarks.edit(path, {:delete, first.id})
    assert {:error, %{code: :gone}} = Bookmarks.edit(path, {:change, first.id, %{"text" => "x"}})
  end

  test "of several people at the same time are all kept", %{tmp_dir: dir} do
    path = Path.join(dir, "walk.bookmarks")
    {:ok, _} = add(path, 0, 0)

    1..12
    |> Task.async_stream(&add(path, &1 * @s, &1 * @s, %{"text" => "t#{&1}"}),
      timeout: 60_000,
      max_concurrency: 8
    )
    |> Enum.each(&assert {:ok, {:ok, _}} = &1)

    assert {:ok, all} = Bookmarks.read(path)
    assert Enum.map(all, & &1.from) == Enum.map(0..12, &(&1 * @s))
  end

  test "reject what a page may not send, and survive a file that somebody has edited", %{
    tmp_dir: dir
  } do
    path = Path.join(dir, "walk.bookmarks")

    for changes <- [
          %{"from" => "5", "to" => "3"},
          %{"from" => "x", "to" => "3"},
          %{"from" => "1"},
          %{"text" => "no time"},
          %{"from" => "1", "to" => "2", "text" => 7},
          %{"from" => "1", "to" => "2", "text" => <<255>>}
        ],
        do: assert({:error, %{code: :bad_request}} = Bookmarks.edit(path, {:add, changes}))

    {:ok, [kept]} = add(path, 3, 3, %{"text" => String.duplicate("a", 9_000)})
    assert String.length(kept.text) == 2_000

    File.write!(
      path,
      ~s({"version": 1, "bookmarks": {"a": {"from": "2", "to": "2"}, "b": 7, "c": {"from": 1}}})
    )

    assert {:ok, [%{id: "a", from: 2}]} = Bookmarks.read(path)
    File.write!(path, ~s({"bookmarks": 7}))
    assert {:ok, []} = Bookmarks.read(path)
    assert {:ok, [_]} = add(path, 1, 1)
  end
end
