defmodule Situ.Store.S3.Program do
  @moduledoc false
  # Finds the program object_port, and builds it on first use. It is not part of the first build, because only object
  # storage needs its 170 crates.
  # See docs/adr/0105-large-libraries-run-in-separate-programs.md.
  alias Situ.Error

  @doc "Returns the path of the program. Builds it if this is a checkout of Situ with a Rust toolchain."
  @spec fetch_path() :: {:ok, Path.t()} | {:error, Error.t()}
  def fetch_path do
    path = find_path()

    cond do
      File.regular?(path) -> {:ok, path}
      script = build_script() -> build_program(script, path)
      true -> {:error, missing_error(path, "#{path} does not exist")}
    end
  end

  @doc "Returns whether the program exists, without building it."
  @spec available?() :: boolean()
  def available?, do: File.regular?(find_path())

  defp find_path do
    System.get_env("SITU_OBJECT_PORT") ||
      Path.join([:code.priv_dir(:situ_store), "objects", "object_port"])
  end

  # The folder of the app is in the checkout, also if it is a link from a build folder.
  defp build_script do
    with nil <- System.get_env("SITU_OBJECT_PORT"),
         {:ok, priv} <- resolve_link(to_string(:code.priv_dir(:situ_store))),
         script = Path.expand(Path.join(priv, "../../../bin/lib/build-object-port")),
         true <- File.regular?(script) and System.find_executable("cargo") != nil do
      script
    else
      _ -> nil
    end
  end

  defp resolve_link(path) do
    case File.read_link(path) do
      {:ok, target} -> {:ok, Path.expand(target, Path.dirname(path))}
      {:error, _} -> {:ok, path}
    end
  end

  defp build_program(script, path) do
    IO.puts(:stderr, "Building object_port, for recordings in object storage (once, minutes) ...")
    {output, status} = System.cmd(script, [], stderr_to_stdout: true)

    if status == 0 and File.regular?(path),
      do: {:ok, path},
      else: {:error, missing_error(path, "its build failed: #{last_lines(output)}")}
  end

  defp last_lines(output),
    do: output |> String.split("\n", trim: true) |> Enum.take(-3) |> Enum.join("; ")

  defp missing_error(_path, why) do
    Error.new(:no_object_port, "object storage needs the program object_port",
      why: why,
      fix: "run bin/setup --with s3 (takes minutes), or set SITU_OBJECT_PORT to its path"
    )
  end
end
