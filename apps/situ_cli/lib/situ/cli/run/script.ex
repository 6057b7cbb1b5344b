defmodule Situ.CLI.Run.Script do
  @moduledoc false
  # Loads the file of `situ run`: evaluates it and finds the pipeline that it defines.
  #
  # A pipeline is a module with `build/2`, or a function of one argument as the file's last value. A file may also run
  # its pipelines itself; its value is then its result. Evaluation is safe here, because the user named the file.
  alias Situ.{Error, Options}

  @value_key :situ_cli_run_script_value

  @type t :: {:pipeline, Situ.Pipeline.spec()} | {:value, term()}

  @doc """
  Evaluates the file and returns its pipeline, or its value if it defines none. `name` is the module, if there are
  several.
  """
  @spec load(Path.t(), String.t() | nil) :: {:ok, t()} | {:error, Error.t()}
  def load(path, name) do
    with {:ok, text} <- read_file(path),
         {:ok, value, modules} <- evaluate(text, path) do
      choose_pipeline(Enum.filter(modules, &pipeline?/1), value, path, name)
    end
  end

  @doc "Chooses the pipeline among loaded modules, as `load/2` does."
  @spec choose_module([module()], Path.t(), String.t() | nil) ::
          {:ok, module()} | {:error, Error.t()}
  def choose_module(modules, path, name) do
    case Enum.filter(modules, &pipeline?/1) do
      [] -> {:error, no_pipeline_error(path)}
      pipelines -> select_module(pipelines, path, name)
    end
  end

  defp read_file(path) do
    case File.read(path) do
      {:ok, text} ->
        {:ok, text}

      {:error, reason} ->
        {:error,
         Error.new(:not_found, "cannot read #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "name an Elixir file, or the folder of a project that `situ new` made"
         )}
    end
  end

  # The compiler returns the modules of the file, but not its value, so the last expression stores it. The code is
  # compiled and not interpreted, because its functions may run for every message.
  defp evaluate(text, path) do
    code = Code.string_to_quoted!(text, file: path, columns: true)
    modules = code |> store_value() |> Code.compile_quoted(path)
    {:ok, Process.delete(@value_key), for({module, _binary} <- modules, do: module)}
  rescue
    error -> {:error, evaluation_error(path, error, __STACKTRACE__)}
  end

  defp store_value({:__block__, meta, [_ | _] = expressions}),
    do: {:__block__, meta, List.update_at(expressions, -1, &store_value/1)}

  defp store_value(expression) do
    quote do
      :erlang.put(unquote(@value_key), unquote(expression))
    end
  end

  defp evaluation_error(_path, %Error{} = error, _stack), do: error

  defp evaluation_error(path, error, _stack)
       when is_struct(error, CompileError) or is_struct(error, SyntaxError) or
              is_struct(error, TokenMissingError) do
    Error.new(:not_compiled, "#{path} cannot be compiled", why: Exception.message(error))
  end

  defp evaluation_error(path, error, stack) do
    Error.new(
      :script_failed,
      "#{path} failed: #{Exception.format_banner(:error, error, stack)}",
      why: Error.format_location(stack)
    )
  end

  # Batch tasks have `build/2` too, but need a session of a dataset.
  defp pipeline?(module) do
    Code.ensure_loaded?(module) and function_exported?(module, :build, 2) and
      not function_exported?(module, :task, 0)
  end

  defp choose_pipeline([], build, _path, nil) when is_function(build, 1),
    do: {:ok, {:pipeline, build}}

  defp choose_pipeline([], value, _path, nil), do: {:ok, {:value, value}}
  defp choose_pipeline([], _value, path, _name), do: {:error, no_pipeline_error(path)}

  defp choose_pipeline(modules, _value, path, name) do
    with {:ok, module} <- select_module(modules, path, name), do: {:ok, {:pipeline, module}}
  end

  defp select_module([module], _path, nil), do: {:ok, module}

  defp select_module(modules, path, nil) do
    {:error,
     Error.new(:several_pipelines, "#{path} defines several pipelines",
       fix: "choose one with --module: #{list_names(modules)}"
     )}
  end

  defp select_module(modules, path, name) do
    case Enum.find(modules, &(inspect(&1) == name)) do
      nil -> {:error, unknown_module_error(modules, path, name)}
      module -> {:ok, module}
    end
  end

  defp unknown_module_error(modules, path, name) do
    near = Options.nearest_name(name, Enum.map(modules, &inspect/1))
    hint = if near, do: "did you mean #{near}? ", else: ""

    Error.new(:unknown_pipeline, "#{path} defines no pipeline #{name}",
      fix: hint <> "It defines: #{list_names(modules)}"
    )
  end

  defp list_names(modules), do: modules |> Enum.map(&inspect/1) |> Enum.sort() |> Enum.join(", ")

  defp no_pipeline_error(path) do
    Error.new(:no_pipeline, "#{path} defines no pipeline",
      fix:
        "define a module with `use Situ.Pipeline` and build/2, or end the file with `fn p -> ... end`"
    )
  end
end
