defmodule Situ.CLI.Run.Project do
  @moduledoc false
  # Loads the pipeline of a Mix project for `situ run FOLDER`: compiles the project with mix, adds its code to the path
  # and finds its pipeline.
  alias Situ.CLI.Checkout
  alias Situ.CLI.Run.Script
  alias Situ.{Error, Pipeline}

  @doc "Compiles the project in `folder` and returns its pipeline. `name` is the module, if there are several."
  @spec load(Path.t(), String.t() | nil) ::
          {:ok, {:pipeline, Pipeline.spec()}} | {:error, Error.t()}
  def load(folder, name) do
    with :ok <- check_project(folder),
         {:ok, mix} <- find_mix(),
         :ok <- compile(mix, folder),
         {:ok, module} <- Script.choose_module(load_modules(folder), folder, name),
         do: {:ok, {:pipeline, module}}
  end

  defp check_project(folder) do
    if File.exists?(Path.join(folder, "mix.exs")) do
      :ok
    else
      {:error,
       Error.new(:no_project, "#{Path.expand(folder)} is not a project: it has no mix.exs",
         fix: "name an Elixir file (situ run FILE.exs), or make a project with `situ new NAME`"
       )}
    end
  end

  defp find_mix do
    case System.find_executable("mix") do
      nil ->
        {:error,
         Error.new(:no_mix, "cannot compile the project: mix is not on the PATH",
           fix: "install Elixir, or name a single file: situ run FILE.exs"
         )}

      mix ->
        {:ok, mix}
    end
  end

  # The project is compiled as `mix compile` in its folder does it, so that both use the same build.
  defp compile(mix, folder) do
    env = [{"MIX_ENV", "dev"}, {"MIX_QUIET", "1"}, {"PATH", Checkout.outer_path()}]

    case System.cmd(mix, ["compile"], cd: folder, env: env, into: IO.stream(:stderr, :line)) do
      {_, 0} ->
        :ok

      {_, status} ->
        {:error,
         Error.new(:not_compiled, "the project #{Path.expand(folder)} cannot be compiled",
           why: "`mix compile` ended with status #{status}; its messages are above"
         )}
    end
  end

  # An application of an umbrella is built in the folder of the umbrella. Situ's applications are loaded already.
  defp load_modules(folder) do
    for build <- ["_build", "../../_build"],
        ebin <-
          folder |> Path.join("#{build}/dev/lib/*/ebin") |> Path.expand() |> Path.wildcard(),
        app_file <- Path.wildcard(Path.join(ebin, "*.app")),
        {:ok, [{:application, app, properties}]} <- [:file.consult(app_file)],
        Application.spec(app) == nil do
      true = Code.append_path(ebin)
      :ok = Application.load(app)
      properties[:modules]
    end
    |> List.flatten()
  end
end
