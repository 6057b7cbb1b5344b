defmodule Situ.CLI.Store.ObjectStorageTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.CLI.Store.ObjectStorage
  alias Situ.CLI.TransferProgress

  doctest ObjectStorage
  doctest TransferProgress

  @moduletag :tmp_dir

  defp situ(argv), do: with_io(:stderr, fn -> Situ.CLI.run(["store" | argv]) end)

  test "explains addresses that cannot be used", %{tmp_dir: root} do
    assert {1, said} = situ(["push", Path.join(root, "nothing"), "s3://lab/rec/"])
    assert said =~ "no store at #{root}/nothing"
    assert {1, said} = situ(["push", root, "s3://key:secret@lab/rec"])
    assert said =~ "contains credentials"
    refute said =~ "secret@"
    assert {1, said} = situ(["sync", root, Path.join(root, "copies")])
    assert said =~ "sync copies between a local folder and an address"
    assert {1, said} = situ(["pull", "http://lab/rec", root])
    assert said =~ "is not an address of object storage"
  end

  test "the rate is that of the last seconds" do
    marks = TransferProgress.add_mark([{0, 0}], {5_000, 50})
    assert marks == [{0, 0}]
    marks = TransferProgress.add_mark(marks, {10_000, 100})
    assert marks == [{10_000, 100}, {0, 0}]
    assert [{20_000, _}, {10_000, _}] = TransferProgress.add_mark(marks, {20_000, 300})
  end
end
