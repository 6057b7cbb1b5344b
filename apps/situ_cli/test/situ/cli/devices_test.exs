defmodule Situ.CLI.DevicesTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO

  defp run(argv), do: with_io(fn -> Situ.CLI.run(["devices" | argv]) end)

  test "lists devices as text and as JSON" do
    assert {0, text} = run([])
    assert text != ""
    {0, json} = run(["--json"])
    {:ok, devices} = Situ.JSON.decode(String.trim(json))
    assert is_list(devices)
    assert Enum.all?(devices, &match?(%{"id" => _, "kind" => _, "default" => _}, &1))
    assert {0, _} = run(["cameras", "--modes"])
  end

  test "wrong usage exits with status 2 and shows the right usage" do
    assert capture_io(:stderr, fn -> assert Situ.CLI.run(["devices", "telescopes"]) == 2 end) =~
             "telescopes"

    assert capture_io(:stderr, fn -> assert Situ.CLI.run(["devices", "--jsn"]) == 2 end) =~
             "--json"

    assert capture_io(fn -> Situ.CLI.run(["devices", "--help"]) end) =~ "Usage: situ devices"
  end
end
