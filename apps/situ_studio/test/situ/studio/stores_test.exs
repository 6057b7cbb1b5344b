defmodule Situ.Studio.StoresTest do
  use ExUnit.Case, async: true
  alias Situ.Store.Writer
  alias Situ.Studio.Stores

  defp record(name, folder) do
    File.mkdir_p!(folder)
    {:ok, writer} = Writer.create(name, folder)
    :ok = Writer.close(writer)
  end

  @tag :tmp_dir
  test "recordings are listed without following links, and found by their names alone", %{
    tmp_dir: tmp
  } do
    root = Path.join(tmp, "recordings")
    record("Talk", root)
    record("Walk", Path.join(root, "may"))
    record("Secret", Path.join(tmp, "elsewhere"))
    File.ln_s!(".", Path.join(root, "a"))
    File.ln_s!("/", Path.join(root, "root"))
    File.ln_s!("../elsewhere", Path.join(root, "out"))
    File.ln_s!("../elsewhere/Secret.0000", Path.join(root, "Linked.0000"))

    assert [{"Talk.0000", talk}, {"may/Walk.0000", walk}] = Enum.sort(Stores.discover(root))
    assert {:ok, ^talk} = Stores.find(root, "Talk.0000")
    assert {:ok, ^walk} = Stores.find(root, "may/Walk.0000")

    for name <- [
          "out/Secret.0000",
          "a/Talk.0000",
          "Linked.0000",
          "../elsewhere/Secret.0000",
          "may/../Talk.0000",
          "/Talk.0000",
          "",
          ".",
          "root",
          "Talk.0000" <> <<0>>,
          <<255>>,
          "none"
        ] do
      assert {name, Stores.find(root, name)} == {name, :error}
    end
  end

  @tag :tmp_dir
  test "a path that is a recording itself has its own name", %{tmp_dir: tmp} do
    record("Talk", tmp)
    path = Path.join(tmp, "Talk.0000")
    assert Stores.discover(path) == [{"Talk.0000", path}]
    assert Stores.find(path, "Talk.0000") == {:ok, path}
    assert Stores.find(path, "Other") == :error
  end
end
