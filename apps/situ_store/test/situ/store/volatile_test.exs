defmodule Situ.Store.VolatileTest do
  use ExUnit.Case, async: false
  alias Situ.Store.{Volatile, Writer}

  test "stores in memory are found by name; those of systems that have gone are swept" do
    root = Volatile.root()
    assert root == Volatile.root() and Path.basename(root) == System.pid()
    name = "volatile#{System.unique_integer([:positive])}"
    assert Volatile.find(name) == nil
    {:ok, writer} = Writer.create(name, root, volatile: true)
    :ok = Writer.close(writer)
    assert Volatile.find(name) == writer.path
    :ok = Situ.Store.delete(writer.path)

    # Beyond the largest number a process can have.
    gone = Path.join(Path.dirname(root), "99999999")
    other = Path.join(Path.dirname(root), "notes")
    Enum.each([gone, other], &File.mkdir_p!/1)
    :persistent_term.erase(Volatile)
    assert Volatile.root() == root
    refute File.exists?(gone)
    assert File.dir?(other)
    File.rmdir!(other)
  end

  @tag :tmp_dir
  test "a folder that somebody else has put in its place is not looked into", %{tmp_dir: root} do
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
      assert Situ.Store.Volatile.find("notes") == nil
    end
  end
end
