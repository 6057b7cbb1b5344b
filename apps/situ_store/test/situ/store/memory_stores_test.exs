defmodule Situ.Store.MemoryStoresTest do
  use ExUnit.Case, async: false
  alias Situ.Store.{MemoryStores, Writer}

  test "finds in-memory stores by name and removes those of ended OS processes" do
    root = MemoryStores.root_folder()
    assert root == MemoryStores.root_folder() and Path.basename(root) == System.pid()
    name = "volatile#{System.unique_integer([:positive])}"
    assert MemoryStores.find_store(name) == nil
    {:ok, writer} = Writer.create(name, root, volatile: true)
    :ok = Writer.close(writer)
    assert MemoryStores.find_store(name) == writer.path
    :ok = Situ.Store.delete(writer.path)

    # This number is larger than any process id.
    gone = Path.join(Path.dirname(root), "99999999")
    other = Path.join(Path.dirname(root), "notes")
    Enum.each([gone, other], &File.mkdir_p!/1)
    :persistent_term.erase(MemoryStores)
    assert MemoryStores.root_folder() == root
    refute File.exists?(gone)
    assert File.dir?(other)
    File.rmdir!(other)
  end

  @tag :tmp_dir
  test "does not follow a link that replaces its folder", %{tmp_dir: root} do
    user = System.get_env("USER")
    name = "foreign-#{System.unique_integer([:positive])}"
    link = Path.join("/dev/shm", "situ-#{name}")

    on_exit(fn ->
      File.rm(link) && if(user, do: System.put_env("USER", user), else: System.delete_env("USER"))
    end)

    {:ok, writer} = Situ.Store.Writer.create("notes", Path.join(root, "1"))
    :ok = Situ.Store.Writer.close(writer)

    if File.dir?("/dev/shm") do
      System.put_env("USER", name)
      File.ln_s!(root, link)
      assert Situ.Store.MemoryStores.find_store("notes") == nil
    end
  end
end
