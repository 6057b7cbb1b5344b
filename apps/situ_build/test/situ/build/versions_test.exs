defmodule Situ.Build.VersionsTest do
  # All packages of a version have the same number.
  use ExUnit.Case, async: true

  @root Path.expand("../../../../..", __DIR__)
  @files [
    {"native/Cargo.toml", ~r/^version = "(.+)"/m},
    {"ports/object_port/Cargo.toml", ~r/^version = "(.+)"/m},
    {"ports/zenoh_port/Cargo.toml", ~r/^version = "(.+)"/m},
    {"apps/situ_infer/native/situ_speak/Cargo.toml", ~r/^version = "(.+)"/m},
    {"native/situ_store_py/pyproject.toml", ~r/^version = "(.+)"/m},
    {"clients/python/pyproject.toml", ~r/^version = "(.+)"/m},
    {"clients/python/src/situ/__init__.py", ~r/^__version__ = "(.+)"/m},
    {"apps/situ_studio/assets/package.json", ~r/"version": "(.+)"/},
    {"integrations/integration.exs", ~r/version: "(.+)"/},
    {"docs/signatures.txt", ~r/^version (.+)$/m},
    {"CITATION.cff", ~r/^version: (.+)$/m}
  ]

  for {file, pattern} <- @files do
    @pattern pattern

    test "#{file} has the version of the apps" do
      text = @root |> Path.join(unquote(file)) |> File.read!()
      assert [_, version] = Regex.run(@pattern, text)
      assert version == Mix.Project.config()[:version]
    end
  end

  test "the changelog describes the version" do
    changelog = @root |> Path.join("CHANGELOG.md") |> File.read!()
    assert changelog =~ "\n## #{Mix.Project.config()[:version]}"
  end
end
