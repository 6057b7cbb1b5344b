defmodule Situ.FetchModelTest do
  # Runs bin/lib/fetch-model with the real pip, which looks for packages only in the test's folder.
  use ExUnit.Case, async: true
  @moduletag :tmp_dir
  @program Path.expand("../../../bin/lib/fetch-model", __DIR__)

  if System.find_executable("python3") == nil, do: @moduletag(skip: "not here: python3")

  defp run(arguments, dir) do
    env = [
      {"SITU_MODELS", Path.join(dir, "models")},
      {"PIP_NO_INDEX", "1"},
      {"PIP_FIND_LINKS", Path.join(dir, "packages")},
      {"PIP_CONFIG_FILE", "/dev/null"}
    ]

    System.cmd(@program, arguments, env: env, stderr_to_stdout: true)
  end

  defp package(dir, files) do
    File.mkdir_p!(Path.join(dir, "packages"))
    info = "hibari_tts-0.2.1.dist-info/"

    own = [
      {info <> "METADATA", "Metadata-Version: 2.1\nName: hibari-tts\nVersion: 0.2.1\n"},
      {info <> "WHEEL",
       "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"},
      # Folders have their own entries.
      {info <> "licenses/", ""},
      {info <> "licenses/LICENSE", "Free."},
      {info <> "RECORD", ""}
    ]

    entries = for {name, bytes} <- own ++ files, do: {to_charlist(name), bytes}
    path = Path.join([dir, "packages", "hibari_tts-0.2.1-py3-none-any.whl"])
    {:ok, _} = :zip.create(to_charlist(path), entries)
  end

  test "rejects files whose checksums differ and leaves no files", %{tmp_dir: dir} do
    package(dir, [{"hibari/assets/hibari.onnx", "other"}, {"hibari/assets/vocab.json", "{}"}])
    assert {said, 1} = run(["hibari"], dir)
    assert said =~ "Apache-2.0"
    assert said =~ "do not match"
    refute File.exists?(Path.join(dir, "models/hibari"))
    assert Path.wildcard(Path.join(dir, "models/*"), match_dot: true) == []
  end

  test "without a network it suggests a fix, and an unknown name lists the known ones", %{
    tmp_dir: dir
  } do
    File.mkdir_p!(Path.join(dir, "packages"))
    assert {said, 1} = run(["hibari"], dir)
    assert said =~ "check the network"
    assert {said, 2} = run(["nobody"], dir)
    assert said =~ "moonshine-tiny-en" and said =~ "hibari" and said =~ "pp-ocr-v4"
  end
end
