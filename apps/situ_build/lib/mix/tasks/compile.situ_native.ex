defmodule Mix.Tasks.Compile.SituNative do
  @moduledoc """
  The Mix compiler that builds an app's Rust NIFs and helper programs.

  An app names its crates and lists the compiler first:

      compilers: [:situ_native] ++ Mix.compilers(),
      native: [crates: ~w(situ_store_nif), binaries: ~w(situ_parquet), programs: ~w(situ_speak)]

  Cargo runs on every compile, with `--locked --release`, in `native/` at the umbrella's root. If nothing has changed,
  this takes about 60 ms. Each library is copied to `priv/native/CRATE.so` by rename, and only if its bytes differ:
  overwriting a loaded library in place would crash the VM. Binaries are programs in the same workspace. A program is a
  separate package in the app's `native/` folder, without dependencies. They are copied to `priv/native/NAME`.

  Cargo does not run, and Rust is not needed, while the libraries that `bin/lib/fetch-libraries` installed are newer
  than every Rust source (ADR 0005).
  """
  use Mix.Task.Compiler

  @recursive true

  @impl true
  def run(_args) do
    native = Mix.Project.config()[:native] || []

    case {native[:crates] || [], native[:binaries] || [], native[:programs] || []} do
      {[], [], []} ->
        {:noop, []}

      {crates, binaries, programs} ->
        build_unless_fetched({crates, binaries}, programs, find_workspace(File.cwd!()))
    end
  end

  defp build_unless_fetched({crates, binaries}, programs, workspace) do
    names = Enum.map(crates, &"#{&1}.so") ++ binaries ++ programs
    mark = Path.join(workspace, "../.situ/libraries")

    if Enum.all?(names, &File.exists?(Path.join("priv/native", &1))) and
         newer_than_sources?(mark, [workspace | Enum.map(programs, &Path.join("native", &1))]),
       do: {:noop, []},
       else: build_native({crates, binaries}, programs, workspace)
  end

  defp newer_than_sources?(mark, folders) do
    case File.stat(mark, time: :posix) do
      {:ok, %{mtime: fetched}} ->
        sources = Enum.flat_map(folders, &list_sources/1)
        Enum.all?(sources, &(File.stat!(&1, time: :posix).mtime <= fetched))

      {:error, _none} ->
        false
    end
  end

  defp list_sources(folder) do
    for entry <- File.ls!(folder),
        entry != "target",
        path = Path.join(folder, entry),
        source <- [path | Path.wildcard(Path.join(path, "**"))],
        do: source
  end

  @impl true
  def clean do
    File.rm_rf!(Path.join(File.cwd!(), "priv/native"))
    :ok
  end

  defp build_native({crates, binaries}, programs, workspace) do
    cargo = System.find_executable("cargo") || raise_missing()
    own = Enum.map(programs, &{&1, Path.join([File.cwd!(), "native", &1])})

    # cargo reads .cargo/config.toml from the current directory, so it runs inside the workspace.
    builds =
      if(crates ++ binaries == [],
        do: [],
        else: [{workspace, Enum.flat_map(crates ++ binaries, &["-p", &1])}]
      ) ++ for {_, folder} <- own, do: {folder, []}

    case run_builds(builds, cargo) do
      0 ->
        from = release_folder(workspace)
        libraries = for crate <- crates, do: {Path.join(from, "lib#{crate}.so"), "#{crate}.so"}
        shared = for name <- binaries, do: {Path.join(from, name), name}
        built = for {name, folder} <- own, do: {Path.join(release_folder(folder), name), name}
        install_files(libraries ++ shared ++ built)

      status ->
        {:error, [build_diagnostic(workspace, status)]}
    end
  end

  defp run_builds(builds, cargo) do
    Enum.reduce_while(builds, 0, fn {folder, packages}, 0 ->
      args = quiet_args(["build", "--release", "--locked"] ++ packages)

      case System.cmd(cargo, args,
             cd: folder,
             into: IO.stream(:stdio, :line),
             stderr_to_stdout: true
           ) do
        {_, 0} -> {:cont, 0}
        {_, status} -> {:halt, status}
      end
    end)
  end

  # Cargo's progress output is for people; by default an up-to-date build prints nothing.
  defp quiet_args(args),
    do: if(System.get_env("SITU_CARGO_VERBOSE"), do: args, else: args ++ ["--quiet"])

  defp release_folder(workspace) do
    Path.join(System.get_env("CARGO_TARGET_DIR") || Path.join(workspace, "target"), "release")
  end

  defp install_files(files) do
    priv = Path.join(File.cwd!(), "priv/native")
    File.mkdir_p!(priv)

    changed =
      for {source, name} <- files,
          target = Path.join(priv, name),
          files_differ?(source, target) do
        File.cp!(source, target <> ".new")
        File.rename!(target <> ".new", target)
        name
      end

    # priv/ may not have existed when the build folder was linked.
    Mix.Project.build_structure()
    {if(changed == [], do: :noop, else: :ok), []}
  end

  defp files_differ?(source, target) do
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

  defp build_diagnostic(workspace, status) do
    %Mix.Task.Compiler.Diagnostic{
      compiler_name: "situ_native",
      file: Path.join(workspace, "Cargo.toml"),
      message: "cargo build failed with status #{status}; its messages are above",
      position: 0,
      severity: :error
    }
  end
end
