defmodule Mix.Tasks.Compile.SituNativeTest do
  # PATH belongs to the whole VM.
  use ExUnit.Case, async: false

  alias Mix.Tasks.Compile.SituNative

  @moduletag :tmp_dir

  setup %{tmp_dir: root} do
    app = Path.join(root, "apps/probe")
    source = Path.join(root, "native/probe_nif/src/lib.rs")
    library = Path.join(app, "priv/native/probe_nif.so")

    for path <- [source, library], do: File.mkdir_p!(Path.dirname(path))
    File.mkdir_p!(Path.join(root, ".situ"))
    File.write!(Path.join(root, "native/Cargo.toml"), "[workspace]")
    File.write!(source, "// a source")
    File.write!(library, "a library")

    File.write!(Path.join(app, "mix.exs"), """
    defmodule Probe#{System.unique_integer([:positive])}.MixProject do
      use Mix.Project
      def project, do: [app: :probe, version: "1.0.0", native: [crates: ~w(probe_nif)]]
    end
    """)

    path = System.get_env("PATH")
    System.put_env("PATH", "/nowhere")
    on_exit(fn -> System.put_env("PATH", path) end)

    %{app: app, mark: Path.join(root, ".situ/libraries"), source: source, library: library}
  end

  test "fetched libraries that are newer than every source need no cargo", context do
    File.write!(context.mark, "apps/probe/priv/native/probe_nif.so\n")
    assert compile(context.app) == {:noop, []}
  end

  test "cargo is needed without fetched libraries", %{app: app} do
    assert_raise Mix.Error, ~r/cargo, Rust's build tool, is not on the PATH/, fn ->
      compile(app)
    end
  end

  test "cargo is needed after a source has changed", context do
    File.write!(context.mark, "apps/probe/priv/native/probe_nif.so\n")
    File.touch!(context.source, System.os_time(:second) + 60)
    assert_raise Mix.Error, fn -> compile(context.app) end
  end

  test "cargo is needed if a library is missing", context do
    File.write!(context.mark, "apps/probe/priv/native/probe_nif.so\n")
    File.rm!(context.library)
    assert_raise Mix.Error, fn -> compile(context.app) end
  end

  defp compile(app), do: Mix.Project.in_project(:probe, app, fn _ -> SituNative.run([]) end)
end
