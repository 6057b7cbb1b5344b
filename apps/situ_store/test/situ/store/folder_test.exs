defmodule Situ.Store.FolderTest do
  use ExUnit.Case, async: true
  import Bitwise
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.{Folder, Writer}

  @moduletag :tmp_dir

  defp mode(path), do: File.stat!(path).mode &&& 0o777
  defp modes(path), do: path |> File.ls!() |> Enum.map(&mode(Path.join(path, &1))) |> Enum.uniq()

  test "versions count up, and the newest is found by name", %{tmp_dir: root} do
    assert {:ok, first} = Folder.create_store_folder("walk", root, true)
    assert {:ok, second} = Folder.create_store_folder("walk", root, true)
    File.mkdir_p!(Path.join(root, "walk.old"))
    File.mkdir_p!(Path.join(root, "walking.0007"))
    assert {Path.basename(first), Path.basename(second)} == {"walk.0000", "walk.0001"}
    assert Folder.newest_version("walk", root) == second
    assert Folder.newest_version("run", root) == nil
    assert {Folder.store_name(second), Folder.version_number(second)} == {"walk", 1}
    assert {Folder.store_name("a.b"), Folder.version_number("a.b")} == {"a.b", nil}
    assert Folder.resolve_store(Path.join(root, "walk")) == second
  end

  test "refuses invalid names and folders", %{tmp_dir: root} do
    for name <- ["", ".", "..", "a/b", "a\0", String.duplicate("x", 201), 5],
        do: assert({:error, %{code: :bad_name}} = Folder.create_store_folder(name, root, true))

    file = Path.join(root, "file")
    File.write!(file, "")
    assert {:error, %{code: :io}} = Folder.create_store_folder("walk", file, true)
  end

  test "deleting a store keeps files that are not part of it", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1]), []}])
    notes = Path.join(path, "notes.txt")
    File.write!(notes, "mine")
    assert :ok = Folder.remove_store(path)
    assert File.ls!(path) == ["notes.txt"]
  end

  test "only the owner and group can read a recording, unless a mode is given", %{
    tmp_dir: root
  } do
    path = store(root, [{"N", messages([1]), []}])
    usual = 0o640 &&& mode(Path.join(path, "index.situ"))
    assert modes(path) == [usual]
    assert (mode(path) &&& 0o027) == 0

    for {asked, folder} <- [{0o600, 0o700}, {0o664, 0o775}] do
      {:ok, writer} = Writer.create("m", root, mode: asked)
      {:ok, stream} = Writer.stream(writer, "N")
      {:ok, _} = Writer.append(stream, messages([1, String.duplicate("x", 40_000)]))
      assert modes(writer.path) == [asked] and mode(writer.path) == folder
      :ok = Writer.close(writer)
      assert modes(writer.path) == [asked]
    end

    assert {:error, %{code: :bad_mode, fix: fix}} = Writer.create("m", root, mode: 0o440)
    assert fix =~ "0o600"
    assert {:error, %{code: :bad_mode}} = Writer.create("m", root, mode: 0o1777)
    assert {:error, %{code: :bad_option}} = Writer.create("m", root, mode: "rw")
  end

  test "a copy has its sources' narrowest mode, and compaction keeps it", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("private", root, mode: 0o600)
    {:ok, stream} = Writer.stream(writer, "N")
    {:ok, _} = Writer.append(stream, messages([1]))
    :ok = Writer.close(writer)
    {:ok, copy} = Store.copy(writer.path, {"copy", root})
    assert modes(copy) == [0o600] and mode(copy) == 0o700
    {:ok, edited} = Store.edit(writer.path, {"edited", root}, %{"N" => [{:delete, 0}]})
    assert modes(edited) == [0o600]
    open = store(root, [{"M", messages([1]), []}], "open")
    {:ok, both} = Store.concat([open, writer.path], {"both", root})
    assert modes(both) == [0o600]

    for name <- File.ls!(writer.path), do: File.chmod!(Path.join(writer.path, name), 0o664)
    File.chmod!(writer.path, 0o775)
    {:ok, path} = Store.compact(writer.path)
    assert modes(path) == [0o664] and mode(path) == 0o775
  end

  test "an existing folder keeps its mode", %{tmp_dir: root} do
    mine = Path.join(root, "mine")
    File.mkdir_p!(mine)
    File.chmod!(mine, 0o755)
    {:ok, writer} = Writer.create("n", mine, versioned: false, mode: 0o600)
    assert mode(mine) == 0o755
    :ok = Writer.close(writer)
  end
end
