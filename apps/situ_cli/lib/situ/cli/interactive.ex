defmodule Situ.CLI.Interactive do
  @moduledoc false
  # `situ iex`: prepares Elixir's shell, which bin/situ starts. The verb only provides the help.
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Output, Verb}
  alias Situ.CLI.Run.{Project, Script}
  alias Situ.Error

  @impl true
  def verbs do
    [
      %Verb{
        words: ["iex"],
        summary: "open Elixir's shell with Situ, and with your file or project",
        about: """
        All applications of Situ are loaded, without compiling anything again. FILE is evaluated first, so that its
        modules are defined. In the folder of a project, the project is compiled and loaded. `h Situ.join` explains an
        operator, and Ctrl-C twice ends the shell.
        """,
        arguments: [file: [kind: :file, optional: true, doc: "an Elixir file to evaluate first"]],
        examples: ["situ iex", "situ iex lobby.exs"],
        run: fn _, _ ->
          raise Error.new(:no_shell, "the shell is started by the script bin/situ",
                  fix: "run `bin/situ iex` in a terminal"
                )
        end
      }
    ]
  end

  @doc "Starts all applications, and loads and reports the file, or the project of the current folder."
  @spec start(Path.t()) :: :ok
  def start(file) do
    {:ok, _} = Application.ensure_all_started(:situ_cli)

    Output.puts("""
    Situ #{Situ.CLI.version()}: `h Situ` explains the operators, `Situ.to_list(fun)` runs a small pipeline, and
    `{:ok, p} = Situ.Pipeline.start_link(fun)` starts one. `Situ.inspect(p)` shows a running pipeline.
    """)

    report_loaded(file, load_code(file))
  end

  defp load_code(""),
    do: if(File.exists?("mix.exs"), do: Project.load(".", nil), else: :nothing)

  defp load_code(file), do: Script.load(file, nil)

  defp report_loaded(_file, :nothing), do: :ok

  defp report_loaded(_file, {:ok, {:pipeline, module}}) when is_atom(module),
    do: Output.puts("Loaded #{inspect(module)}: Situ.Pipeline.start_link(#{inspect(module)})")

  defp report_loaded(file, {:ok, _}), do: Output.puts("Evaluated #{file}")

  # The project may have several pipelines, or none; its code is loaded all the same.
  defp report_loaded(_file, {:error, %Error{code: code}})
       when code in [:several_pipelines, :no_pipeline],
       do: :ok

  defp report_loaded(_file, {:error, error}), do: Output.warn(Exception.message(error))
end
