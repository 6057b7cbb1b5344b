defmodule Situ.Store.EditingTest do
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Test.Raw

  @moduletag :tmp_dir

  # {"never_heard_of_this_atom", 1} with an atom that no system knows; 119 is the tag of a small atom.
  @foreign <<131, 104, 2, 119, 25, "never_heard_of_this_at0m_", 97, 1>>

  defp data(path, stream),
    do: path |> Store.open!() |> Store.messages(stream) |> Enum.map(& &1.data)

  defp holds?(path, bytes) do
    path |> Path.join("data-*") |> Path.wildcard() |> Enum.any?(&(File.read!(&1) =~ bytes))
  end

  test "replaces, inserts and deletes messages and leaves the rest unchanged", %{tmp_dir: root} do
    path = Raw.written(root, @foreign)
    edits = %{"T" => [{:upsert, -5, "before"}, {:upsert, 7, "behind"}, {:delete, 99}]}
    {:ok, edited} = Store.edit(path, {"e", root}, edits)
    assert data(edited, "T") == ["before", {"never_heard_of_this_at0m_", 1}, "behind"]
    assert holds?(edited, @foreign)
    {:ok, none} = Store.edit(path, {"e", root}, %{"T" => [{:delete, 0}]})
    assert data(none, "T") == []
    numbers = store(root, [{"N", messages([1, 2, 3]), [type: :integer]}])
    {:ok, edited} = Store.edit(numbers, {"e", root}, %{"N" => [{:upsert, 1_000, 20}]})
    [_, changed, _] = edited |> Store.open!() |> Store.messages("N") |> Enum.to_list()
    assert %{data: 20, sequence_id: 2, creation_time: 1_005} = changed
  end

  test "refuses an edit of the wrong type and creates nothing", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1, 2, 3]), [type: :integer]}])
    edits = %{"N" => [{:upsert, 0, "one"}]}
    assert {:error, %{code: :type_mismatch, why: why}} = Store.edit(path, {"e", root}, edits)
    assert why =~ ":integer"
    assert Store.newest("e", root) == nil
  end

  test "messages inserted after a stream's end are replayed and copied", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1, 2, 3]), [type: :integer]}])

    {:ok, edited} =
      Store.edit(path, Path.join(root, "edited"), %{
        "N" => [{:upsert, 9_000, 4}, {:delete, 9_500}]
      })

    assert [%{closed: 9_000}] = Store.streams(Store.open!(edited))
    {:ok, copied} = Store.copy(edited, Path.join(root, "copied"))

    for path <- [edited, copied] do
      assert path |> Situ.Store.Test.Play.replay("N") |> Enum.map(& &1.data) == [1, 2, 3, 4]
    end
  end
end
