defmodule Mix.Tasks.Compile.SituNative do
  @moduledoc """
  The Mix compiler that builds an app's Rust NIFs.

  An app names its crates and lists the compiler first:

      compilers: [:situ_native] ++ Mix.compilers(),
      native: [crates: ~w(situ_store_nif)]

  Cargo runs on every compile (its own check of an unchanged tree takes about 60 ms) with `--locked --release`, from
  `native/` at the umbrella's root. Each library is copied to `priv/native/CRATE.so` by rename, and only when its bytes
  differ: overwriting a loaded library in place would kill the VM.
  """
  use Mix.Task.Compiler

  @recursive true

  @impl true
  def run(_args) do
    case Mix.Project.config()[:native][:crates] || [] do
      [] -> {:noop, []}
      crates -> build(crates, find_workspace(File.cwd!()))
    end
  end

  @impl true
  def clean do
    File.rm_rf!(Path.join(File.cwd!(), "priv/native"))
    :ok
  end

  defp build(crates, workspace) do
    cargo = System.find_executable("cargo") || raise_missing()
    args = ["build", "--release", "--locked"] ++ Enum.flat_map(crates, &["-p", &1])
    # cargo reads .cargo/config.toml from the current directory, so it runs inside the workspace.
    into = IO.stream(:stdio, :line)

    case System.cmd(cargo, quiet(args), cd: workspace, into: into, stderr_to_stdout: true) do
      {_, 0} -> install(crates, target_dir(workspace))
      {_, status} -> {:error, [diagnostic(workspace, status)]}
    end
  end

  # Progress when a person watches, silence when nothing is to do.
  defp quiet(args),
    do: if(System.get_env("SITU_CARGO_VERBOSE"), do: args, else: args ++ ["--quiet"])

  defp target_dir(workspace) do
    Path.join(System.get_env("CARGO_TARGET_DIR") || Path.join(workspace, "target"), "release")
  end

  defp install(crates, from) do
    priv = Path.join(File.cwd!(), "priv/native")
    File.mkdir_p!(priv)

    changed =
      for crate <- crates,
          source = Path.join(from, "lib#{crate}.so"),
          target = Path.join(priv, "#{crate}.so"),
          differs?(source, target) do
        File.cp!(source, target <> ".new")
        File.rename!(target <> ".new", target)
        crate
      end

    # priv/ may not have existed when the build folder was linked.
    Mix.Project.build_structure()
    {if(changed == [], do: :noop, else: :ok), []}
  end

  defp differs?(source, target) do
    case {File.stat(source), File.stat(target)} do
      {{:ok, %{size: same}}, {:ok, %{size: same}}} -> File.read!(source) != File.read!(target)
      _ -> true
    end
  end

  defp find_workspace(dir) do
    candidate = Path.join(dir, "native/Cargo.toml")

    cond do
      File.exists?(candidate) -> Path.dirname(candidate)
      Path.dirname(dir) == dir -> Mix.raise("no native/Cargo.toml in #{File.cwd!()} or above it")
      true -> find_workspace(Path.dirname(dir))
    end
  end

  defp raise_missing do
    Mix.raise("""
    cargo, Rust's build tool, is not on the PATH, and #{Mix.Project.config()[:app]} has native code.
      Fix: run bin/setup, or install Rust 1.92 or newer from https://rustup.rs
    """)
  end

  defp diagnostic(workspace, status) do
    %Mix.Task.Compiler.Diagnostic{
      compiler_name: "situ_native",
      file: Path.join(workspace, "Cargo.toml"),
      message: "cargo build failed with status #{status}; its messages are above",
      position: 0,
      severity: :error
    }
  end
end
