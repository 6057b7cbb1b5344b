defmodule Situ.Build.CheckoutTest do
  use ExUnit.Case, async: true
  alias Situ.Build.Checkout

  @tag :tmp_dir
  test "lists tracked and new files, without deleted and ignored ones", %{tmp_dir: tmp} do
    git = fn arguments ->
      {_, 0} = System.cmd("git", arguments, cd: tmp, stderr_to_stdout: true)
    end

    git.(["init", "--quiet"])
    for name <- ~w(tracked deleted), do: File.write!(Path.join(tmp, name), "")
    git.(["add", "."])
    File.rm!(Path.join(tmp, "deleted"))
    File.write!(Path.join(tmp, ".gitignore"), "ignored\n")
    for name <- ~w(new ignored), do: File.write!(Path.join(tmp, name), "")
    assert Enum.sort(Checkout.list_files(tmp)) == [".gitignore", "new", "tracked"]
  end
end
