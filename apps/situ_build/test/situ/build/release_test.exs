defmodule Situ.Build.ReleaseTest do
  use ExUnit.Case, async: true
  doctest Situ.Build.Release

  test "removes every cookie from Mix's script and keeps it a valid script" do
    closed = Situ.Build.Release.without_cookie(Mix.Tasks.Release.Init.cli_text())
    refute closed =~ "COOKIE"
    assert closed =~ "--boot "
    path = Path.join(System.tmp_dir!(), "situ-release-#{System.unique_integer([:positive])}.sh")
    File.write!(path, closed)
    on_exit(fn -> File.rm(path) end)
    assert {_, 0} = System.cmd("sh", ["-n", path])
  end

  test "refuses a script with a different structure" do
    for script <- ["exec elixir --start", "exec elixir --secret $RELEASE_COOKIE"],
        do: assert_raise(Mix.Error, fn -> Situ.Build.Release.without_cookie(script) end)
  end
end
