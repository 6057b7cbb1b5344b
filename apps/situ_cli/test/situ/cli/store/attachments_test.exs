defmodule Situ.CLI.Store.AttachmentsTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.Bridge.Native

  @moduletag :tmp_dir

  setup %{tmp_dir: root} do
    path = Path.join(root, "drive.mcap")
    {:ok, writer} = Native.mcap_create(path, "ros1", :none, 1_024)
    {:ok, _} = Native.mcap_attach(writer, "calibration.yaml", "text/yaml", 5_000, "focal: 600\n")
    {:ok, _} = Native.mcap_attach(writer, "evil\e[2J", "x/y", 6_000, <<0, 1, 255>>)
    {:ok, _} = Native.mcap_metadata(writer, "robot", [{"serial", "42"}])
    {:ok, _} = Native.mcap_finish(writer)
    %{path: path}
  end

  defp situ(argv), do: with_io(fn -> Situ.CLI.run(["store" | argv]) end)

  test "lists attachments, and escapes control characters in names", %{path: path} do
    assert {0, said} = situ(["attachments", path])
    assert said =~ "calibration.yaml" and said =~ "text/yaml" and said =~ "11 B"
    refute said =~ "\e"
    assert {0, json} = situ(["attachments", path, "--json"])

    assert {:ok, [%{"name" => "calibration.yaml", "size" => 11, "time" => 5_000}, _]} =
             Situ.JSON.decode(json)
  end

  test "extracts one attachment", %{path: path, tmp_dir: root} do
    assert situ(["attachments", path, "calibration.yaml"]) == {0, "focal: 600\n"}
    out = Path.join(root, "c.yaml")
    assert {0, _} = situ(["attachments", path, "calibration.yaml", "-o", out])
    assert File.read!(out) == "focal: 600\n"

    said =
      capture_io(:stderr, fn ->
        assert Situ.CLI.run(["store", "attachments", path, "none"]) == 1
      end)

    assert said =~ "no attachment"
  end

  test "info shows attachments and the metadata of the file", %{path: path} do
    assert {0, said} = situ(["info", path])

    assert said =~ "2 attachments" and said =~ "metadata robot: serial=42" and
             said =~ "profile ros1"

    assert {0, json} = situ(["info", path, "--json"])

    assert {:ok, [%{"metadata" => %{"robot" => %{"serial" => "42"}}, "attachments" => [_, _]}]} =
             Situ.JSON.decode(json)
  end

  test "rejects files that are not MCAP files", %{tmp_dir: root} do
    wav = Path.join(root, "a.csv")
    File.write!(wav, "time,x\n1,2\n")
    said = capture_io(:stderr, fn -> assert Situ.CLI.run(["store", "attachments", wav]) == 1 end)
    assert said =~ "not an MCAP file"
  end
end
