defmodule Situ.CLI.DevicesTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO

  alias Situ.CLI.Devices

  test "lists devices as text and as JSON" do
    assert capture_io(fn -> assert Devices.run([]) == 0 end) != ""
    json = capture_io(fn -> assert Devices.run(["--json"]) == 0 end)
    {:ok, devices} = Situ.JSON.decode(String.trim(json))
    assert is_list(devices)
    assert Enum.all?(devices, &match?(%{"id" => _, "kind" => _, "default" => _}, &1))
    assert capture_io(fn -> assert Devices.run(["cameras", "--modes"]) == 0 end) != ""
  end

  test "wrong usage is status 2 and says how it goes" do
    assert capture_io(:stderr, fn -> assert Devices.run(["telescopes"]) == 2 end) =~ "telescopes"
    assert capture_io(:stderr, fn -> assert Devices.run(["--jsn"]) == 2 end) =~ "--help"
    assert capture_io(fn -> Situ.CLI.run(["devices", "--help"]) end) =~ "Usage: situ devices"
  end
end
