defmodule Situ.Studio.Plugins.Code do
  @moduledoc false
  # Loads the Elixir half of a plug-in: compiles the modules below its `lib/` into this VM, once
  # for each version of a file.
  #
  # A plug-in cannot define a module that already exists, so that it does not replace one of
  # Situ's modules by accident.
  alias Situ.Error

  @doc "Loads the modules of a plug-in. Errors are `:bad_plugin` with the compiler's message."
  @spec load_modules(Path.t()) :: {:ok, [module()]} | {:error, Error.t()}
  def load_modules(folder) do
    files = folder |> Path.join("lib/**/*.ex") |> Path.wildcard() |> Enum.sort()
    key = {__MODULE__, folder}
    {stamp, modules} = :persistent_term.get(key, {nil, []})

    case file_hashes(files) do
      ^stamp -> {:ok, modules}
      new -> recompile_files(files, modules, &:persistent_term.put(key, {new, &1}))
    end
  end

  defp file_hashes(files), do: for(file <- files, do: {file, :erlang.md5(File.read!(file))})

  defp recompile_files(files, before, keep) do
    with {:ok, names} <- defined_modules(files, []),
         :ok <- check_unused(names -- before),
         :ok <- unload_modules(before),
         {:ok, modules} <- compile_files(files) do
      keep.(modules)
      {:ok, modules}
    end
  end

  # Finds the modules that the files define, before any of their code is run.
  defp defined_modules([], names), do: {:ok, names}

  defp defined_modules([file | files], names) do
    case file |> File.read!() |> Code.string_to_quoted(file: file) do
      {:ok, quoted} ->
        defined_modules(files, names ++ module_names(quoted))

      {:error, {meta, what, token}} ->
        what = if is_tuple(what), do: Enum.join(Tuple.to_list(what)), else: what
        plugin_error("#{Path.basename(file)}, line #{meta[:line]}: #{what}#{token}")
    end
  end

  defp module_names(quoted) do
    {_, names} =
      Macro.prewalk(quoted, [], fn
        {:defmodule, _, [{:__aliases__, _, parts} | _]} = node, names ->
          if Enum.all?(parts, &is_atom/1),
            do: {node, [Module.concat(parts) | names]},
            else: {node, names}

        node, names ->
          {node, names}
      end)

    names
  end

  defp check_unused(names) do
    case Enum.find(names, &Code.ensure_loaded?/1) do
      nil ->
        :ok

      taken ->
        plugin_error("it defines #{inspect(taken)}, which already exists: choose another name")
    end
  end

  defp unload_modules(modules) do
    for module <- modules do
      :code.purge(module)
      :code.delete(module)
    end

    :ok
  end

  defp compile_files(files) do
    modules = for file <- files, {module, _} <- Code.compile_file(file), do: module
    {:ok, modules}
  rescue
    error -> plugin_error(Exception.message(error))
  catch
    kind, reason ->
      plugin_error("its code failed while it was loaded: #{inspect({kind, reason}, limit: 5)}")
  end

  defp plugin_error(what),
    do: {:error, Error.new(:bad_plugin, what, fix: "correct the plug-in, and restart the studio")}

  @doc "Filters modules by a behaviour that they implement."
  @spec filter_by_behaviour([module()], module()) :: [module()]
  def filter_by_behaviour(modules, behaviour) do
    Enum.filter(modules, fn module ->
      attributes = module.module_info(:attributes)
      behaviour in Enum.flat_map(Keyword.get_values(attributes, :behaviour), &List.wrap/1)
    end)
  end
end
