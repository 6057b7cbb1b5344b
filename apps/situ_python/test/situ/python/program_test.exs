defmodule Situ.Python.ProgramTest do
  use ExUnit.Case, async: true
  alias Situ.Python.{Package, Program}
  doctest Program

  @moduletag :tmp_dir

  test "finds the interpreter of a virtual environment", %{tmp_dir: dir} do
    File.mkdir_p!(Path.join(dir, "bin"))
    File.write!(Path.join(dir, "bin/python"), "")
    assert Program.find_interpreter(dir) == {:ok, Path.expand(Path.join(dir, "bin/python"))}
    assert {:error, %{fix: fix}} = Program.find_interpreter(Path.join(dir, "bin"))
    assert fix =~ "python3 -m venv"
  end

  test "the package for workers equals the client's", %{tmp_dir: _dir} do
    client = Path.expand("../../../../../clients/python/src/situ", __DIR__)

    for file <- Path.wildcard(Path.join(client, "*.py")) do
      copy = Path.join([Package.folder(), "situ", Path.basename(file)])
      assert File.read!(copy) == File.read!(file)
    end
  end
end
