defmodule Situ.CLI.DoctorTest do
  use ExUnit.Case
  import ExUnit.CaptureIO
  alias Situ.CLI.Doctor.{Check, Checks}

  doctest Situ.CLI.Doctor.Check

  @tag :tmp_dir
  test "names what is missing, its purpose and the command that installs it", %{tmp_dir: empty} do
    path = System.get_env("PATH")
    System.put_env("PATH", empty)
    on_exit(fn -> System.put_env("PATH", path) end)

    checks = Checks.run_all()
    ffmpeg = Enum.find(checks, &(&1.name == "ffmpeg"))
    assert Check.required_and_missing?(ffmpeg)
    assert ffmpeg.fix == "sudo apt install ffmpeg"
    assert Enum.all?(checks, &(&1.status == :ok or is_binary(&1.fix)))

    output = capture_io(fn -> assert Situ.CLI.run(["doctor"]) == 1 end)
    assert output =~ "missing  ffmpeg: video and audio files"
    zenoh = Enum.find(checks, &(&1.name == "zenoh_port"))
    if zenoh.status == :missing, do: assert(zenoh.fix =~ ~r"\A/.*/bin/setup --with ros2\z")
    assert output =~ "Run this first:\n  sudo apt install ffmpeg"
  end

  test "prints JSON for programs" do
    output = capture_io(fn -> assert Situ.CLI.run(["doctor", "--json"]) == 0 end)
    {:ok, %{"checks" => checks, "devices" => devices}} = Situ.JSON.decode(output)
    assert is_list(devices)
    assert %{"status" => "ok", "found" => version} = Enum.find(checks, &(&1["name"] == "ffmpeg"))
    assert version =~ ~r/^\d/
  end
end
