defmodule Situ.ScratchTest do
  use ExUnit.Case, async: true
  alias Situ.Scratch

  doctest Scratch
  @moduletag :tmp_dir

  defp mode(path), do: Bitwise.band(File.lstat!(path).mode, 0o777)

  test "two folders have two names that nobody could have guessed", %{tmp_dir: root} do
    {:ok, first} = Scratch.create("film", root)
    {:ok, second} = Scratch.create("film", root)
    assert first != second and mode(first) == 0o700 and mode(second) == 0o700
    assert byte_size(Path.basename(first)) >= byte_size("situ-film-") + 20
  end

  test "the folder is gone after use, also when that fails" do
    parent = self()
    keep = fn folder -> send(parent, {:folder, folder}) && raise "no" end
    assert_raise RuntimeError, fn -> Scratch.with_folder("test", keep) end
    assert_received {:folder, folder}
    refute File.exists?(folder)
  end

  test "a folder of a known name is made or taken, and closed", %{tmp_dir: root} do
    folder = Path.join(root, "known")
    assert Scratch.claim(folder) == :ok and mode(folder) == 0o700
    File.chmod!(folder, 0o777)
    assert Scratch.claim(folder) == :ok and mode(folder) == 0o700
  end

  test "a link or a file of that name is refused, and what it points to stays as it was", %{
    tmp_dir: root
  } do
    target = Path.join(root, "target")
    File.mkdir!(target)
    File.chmod!(target, 0o755)
    link = Path.join(root, "link")
    File.ln_s!(target, link)
    assert {:error, %{code: :no_scratch}} = Scratch.claim(link)
    assert mode(target) == 0o755
    file = Path.join(root, "file")
    File.touch!(file)
    assert {:error, %{code: :no_scratch}} = Scratch.claim(file)
    assert {:error, %{code: :no_scratch}} = Scratch.claim(Path.join(root, "missing/below"))
  end

  test "a parent that is not there is an error", %{tmp_dir: root} do
    assert {:error, %{code: :no_scratch}} = Scratch.create("x", Path.join(root, "missing"))
  end
end
