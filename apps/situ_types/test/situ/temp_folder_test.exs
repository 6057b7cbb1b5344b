defmodule Situ.TempFolderTest do
  use ExUnit.Case, async: true
  alias Situ.TempFolder

  doctest TempFolder
  @moduletag :tmp_dir

  defp mode(path), do: Bitwise.band(File.lstat!(path).mode, 0o777)

  test "two folders get different names that nobody can guess", %{tmp_dir: root} do
    {:ok, first} = TempFolder.create_folder("film", root)
    {:ok, second} = TempFolder.create_folder("film", root)
    assert first != second and mode(first) == 0o700 and mode(second) == 0o700
    assert byte_size(Path.basename(first)) >= byte_size("situ-film-") + 20
  end

  test "removes the folder after use, even after an error" do
    parent = self()
    keep = fn folder -> send(parent, {:folder, folder}) && raise "no" end
    assert_raise RuntimeError, fn -> TempFolder.with_folder("test", keep) end
    assert_received {:folder, folder}
    refute File.exists?(folder)
  end

  test "claims a new or existing folder and restricts its mode", %{tmp_dir: root} do
    folder = Path.join(root, "known")
    assert TempFolder.claim_folder(folder) == :ok and mode(folder) == 0o700
    File.chmod!(folder, 0o777)
    assert TempFolder.claim_folder(folder) == :ok and mode(folder) == 0o700
  end

  test "refuses a link or a file and leaves the link's target unchanged", %{tmp_dir: root} do
    target = Path.join(root, "target")
    File.mkdir!(target)
    File.chmod!(target, 0o755)
    link = Path.join(root, "link")
    File.ln_s!(target, link)
    assert {:error, %{code: :no_scratch}} = TempFolder.claim_folder(link)
    assert mode(target) == 0o755
    file = Path.join(root, "file")
    File.touch!(file)
    assert {:error, %{code: :no_scratch}} = TempFolder.claim_folder(file)

    assert {:error, %{code: :no_scratch}} =
             TempFolder.claim_folder(Path.join(root, "missing/below"))
  end

  test "returns an error for a missing parent", %{tmp_dir: root} do
    assert {:error, %{code: :no_scratch}} =
             TempFolder.create_folder("x", Path.join(root, "missing"))
  end
end
