defmodule Situ.Experiment.CodeVersion do
  @moduledoc false
  # Identifies the code that a function depends on, so that results of the same code are not computed again.
  #
  # Within the function's module, only the functions that it calls count, without their line numbers. A new value of a
  # parameter, or another metric, therefore changes nothing. All modules that these functions refer to count completely,
  # and so do the modules that those refer to, native libraries and models of their applications. Elixir and OTP do not
  # count, because that would make every result invalid after an upgrade; a run records their versions.
  # See docs/adr/0173-cached-results-are-found-by-their-code.md.

  alias Situ.Experiment.ResultsFile

  @enforce_keys [:table]
  defstruct [:table, binaries: %{}]

  @type t :: %__MODULE__{table: :ets.table(), binaries: %{module() => binary()}}

  @typedoc "The hashes of modules and files, to compare them on another node."
  @type parts :: %{
          modules: %{module() => String.t()},
          assets: [{String.t(), String.t()}],
          files: [{Path.t(), String.t()}]
        }

  @doc """
  Begins a calculation. `binaries` are the modules that were compiled from a file, which are not on disk. The calling
  process owns the table that remembers results.
  """
  @spec new(%{module() => binary()}) :: t()
  def new(binaries \\ %{}) do
    table = :ets.new(:code_version, [:public])
    :ets.insert(table, for({module, path} <- list_beams(), do: {{:beam, module}, path}))
    :ets.insert(table, for({module, own?} <- list_known_modules(), do: {{:known, module}, own?}))
    %__MODULE__{table: table, binaries: binaries}
  end

  # The search of the code server takes a millisecond for each module. The first folder of the path counts.
  defp list_beams do
    for folder <- Enum.reverse(:code.get_path()),
        path <- ResultsFile.list_files(to_string(folder), ".beam"),
        do: {Path.basename(path, ".beam"), path}
  end

  @doc "Returns the hash of the code that `module.function` depends on, in hexadecimal digits."
  @spec hash_function(t(), module(), atom()) :: String.t()
  def hash_function(%__MODULE__{} = code, module, function) do
    remember(code, {:function, module, function}, fn ->
      {own, atoms} = reachable_code(code, module, function)
      modules = code |> collect_modules(atoms, MapSet.new([module])) |> MapSet.delete(module)
      parts = for m <- Enum.sort(modules), do: {m, module_hash(code, m)}
      hash_term({own, parts, asset_hashes(code, [module | Enum.to_list(modules)])})
    end)
  end

  @doc """
  Returns the hash of parameters. A module among them counts with its code, and the path of a file with its content.
  """
  @spec hash_values(t(), map()) :: String.t()
  def hash_values(%__MODULE__{} = code, values) do
    atoms = collect_atoms(values, MapSet.new())
    modules = code |> collect_modules(atoms, MapSet.new()) |> Enum.sort()

    files = for {_, v} <- values, file?(v), do: hash_file(v)

    hashes = Enum.map(modules, &module_hash(code, &1))
    hash_term({Enum.sort(values), hashes, asset_hashes(code, modules), files})
  end

  @doc "Returns the models that the code of a function can load, by path in their application, with their hashes."
  @spec list_models(t(), module(), atom()) :: %{String.t() => String.t()}
  def list_models(%__MODULE__{} = code, module, function) do
    {_, atoms} = reachable_code(code, module, function)
    modules = collect_modules(code, atoms, MapSet.new([module]))

    for {path, hash} <- asset_hashes(code, modules),
        path =~ "/models/",
        into: %{},
        do: {path, hash}
  end

  @doc """
  Returns the modules and files that the functions of a module and its parameters (`parameters/0`) depend on.
  """
  @spec list_parts(t(), module(), [atom()], keyword()) :: parts()
  def list_parts(%__MODULE__{} = code, module, functions, parameters) do
    reached = for f <- functions, {_, atoms} = reachable_code(code, module, f), do: atoms
    atoms = Enum.reduce(reached, collect_atoms(parameters, MapSet.new()), &MapSet.union/2)
    modules = collect_modules(code, atoms, MapSet.new([module]))

    %{
      modules: Map.new(modules, &{&1, module_hash(code, &1)}),
      assets: asset_hashes(code, modules),
      files: list_parameter_files(parameters)
    }
  end

  defp list_parameter_files(parameters) do
    for {_, values} <- parameters,
        is_list(values),
        path <- values,
        file?(path),
        do: {path, hash_file(path)}
  end

  defp file?(value), do: is_binary(value) and String.valid?(value) and File.regular?(value)

  @doc "Returns the names of the parts that are different or missing here, sorted."
  @spec find_differences(t(), parts()) :: [String.t()]
  def find_differences(%__MODULE__{} = code, %{modules: modules} = parts) do
    own_assets = asset_hashes(code, Map.keys(modules))
    assets = for {name, _} = asset <- parts.assets, asset not in own_assets, do: name
    files = for {path, hash} <- parts.files, not file?(path) or hash_file(path) != hash, do: path

    # The code that was loaded first runs, even if its file has changed since.
    different = for {m, hash} <- modules, loaded_hash(m) != hash, do: inspect(m)
    Enum.sort(different ++ assets ++ files)
  end

  @doc """
  Returns the SHA-256 of a term, in 64 hexadecimal digits. Equal terms have equal hashes in every VM.

      iex> Situ.Experiment.CodeVersion.hash_term(%{a: 1}) == Situ.Experiment.CodeVersion.hash_term(%{a: 1})
      true
  """
  @spec hash_term(term()) :: String.t()
  def hash_term(term) do
    :sha256
    |> :crypto.hash(:erlang.term_to_binary(term, [:deterministic, minor_version: 2]))
    |> Base.encode16(case: :lower)
  rescue
    # OTP 24.1 introduced the option; terms without large maps are the same without it.
    ArgumentError ->
      Base.encode16(:crypto.hash(:sha256, :erlang.term_to_binary(term)), case: :lower)
  end

  defp remember(code, key, fun) do
    case :ets.lookup(code.table, key) do
      [{_, value}] ->
        value

      [] ->
        value = fun.()
        :ets.insert(code.table, {key, value})
        value
    end
  end

  # The functions of the module that `function` reaches, and all atoms in them. Without debug information, the whole
  # module counts.
  defp reachable_code(code, module, function) do
    remember(code, {:reachable, module, function}, fn ->
      with {:ok, beam} <- find_beam(code, module),
           {:ok, bytes} <- read_beam(beam),
           {:ok, definitions} <- read_definitions(bytes, module) do
        clauses = reach_definitions([function], definitions, %{})
        {clauses, collect_atoms(clauses, MapSet.new())}
      else
        _ -> {module_hash(code, module), MapSet.new(module_atoms(code, module))}
      end
    end)
  end

  defp read_definitions(bytes, module) do
    with {:ok, {_, [debug_info: {:debug_info_v1, backend, data}]}} <-
           :beam_lib.chunks(bytes, [:debug_info]),
         {:ok, %{definitions: definitions}} <- backend.debug_info(:elixir_v1, module, data, []) do
      {:ok, Enum.group_by(definitions, fn {{name, _}, _, _, _} -> name end, &clean_definition/1)}
    else
      _ -> :error
    end
  end

  defp clean_definition({name, kind, _meta, clauses}) do
    {name, kind, for({_, args, guards, body} <- clauses, do: clean_code({args, guards, body}))}
  end

  defp clean_code({args, guards, body}) do
    clean = fn ast -> Macro.prewalk(ast, &Macro.update_meta(&1, fn _ -> [] end)) end
    {Enum.map(args, clean), Enum.map(guards, clean), clean.(body)}
  end

  defp reach_definitions([], _definitions, reached), do: reached |> Map.values() |> Enum.sort()

  defp reach_definitions([name | rest], definitions, reached) do
    if is_map_key(reached, name) or not is_map_key(definitions, name) do
      reach_definitions(rest, definitions, reached)
    else
      own = definitions[name]
      next = for atom <- collect_atoms(own, MapSet.new()), is_map_key(definitions, atom), do: atom
      reach_definitions(next ++ rest, definitions, Map.put(reached, name, own))
    end
  end

  defp collect_atoms(atom, atoms) when is_atom(atom), do: MapSet.put(atoms, atom)

  defp collect_atoms(tuple, atoms) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> collect_atoms(atoms)

  defp collect_atoms([head | tail], atoms), do: collect_atoms(tail, collect_atoms(head, atoms))

  defp collect_atoms(map, atoms) when is_map(map),
    do: map |> Map.to_list() |> collect_atoms(atoms)

  defp collect_atoms(_other, atoms), do: atoms

  defp collect_modules(code, atoms, seen) do
    new = for atom <- atoms, atom not in seen, counted?(code, atom), do: atom

    Enum.reduce(new, seen, fn module, seen ->
      if module in seen,
        do: seen,
        else: collect_modules(code, module_atoms(code, module), MapSet.put(seen, module))
    end)
  end

  # Modules of Elixir and OTP do not count, and neither do atoms that are not modules.
  defp counted?(code, atom) do
    case :ets.lookup(code.table, {:known, atom}) do
      _ when is_map_key(code.binaries, atom) ->
        true

      [{_, own?}] ->
        own?

      [] ->
        elixir_module?(atom) and remember(code, {:counted, atom}, fn -> own_file?(code, atom) end)
    end
  end

  defp elixir_module?(atom), do: match?("Elixir." <> _, Atom.to_string(atom))

  # The modules of all loaded applications, and whether they count.
  defp list_known_modules do
    for {app, _, _} <- Application.loaded_applications(),
        own? = not platform_app?(app),
        module <- Application.spec(app, :modules) || [],
        do: {module, own?}
  end

  defp platform_app?(app) do
    case :code.lib_dir(app) do
      {:error, _} -> false
      folder -> platform_folder?(to_string(folder))
    end
  end

  defp own_file?(code, atom) do
    case find_beam(code, atom) do
      {:ok, path} -> not (path |> Path.dirname() |> Path.dirname() |> platform_folder?())
      :error -> :code.is_loaded(atom) != false
    end
  end

  defp platform_folder?(folder) do
    own? = folder |> Path.basename() |> String.starts_with?("situ")
    not own? and Path.dirname(folder) in platform_folders()
  end

  defp platform_folders do
    for app <- [:stdlib, :elixir],
        path = :code.lib_dir(app),
        is_list(path),
        do: Path.dirname(path)
  end

  defp find_beam(%{binaries: binaries}, module) when is_map_key(binaries, module),
    do: {:ok, binaries[module]}

  defp find_beam(code, module) do
    case :code.is_loaded(module) do
      {:file, [_ | _] = path} -> if File.regular?(path), do: {:ok, to_string(path)}, else: :error
      {:file, _} -> :error
      false -> find_file(code, module)
    end
  end

  defp find_file(code, module) do
    case :ets.lookup(code.table, {:beam, Atom.to_string(module)}) do
      [{_, path}] -> {:ok, path}
      [] -> :error
    end
  end

  defp module_hash(code, module), do: code |> read_module(module) |> elem(0)
  defp module_atoms(code, module), do: code |> read_module(module) |> elem(1)

  # A module that another program compiled in memory has no file, but its loaded code has a hash.
  defp read_module(code, module) do
    remember(code, {:module, module}, fn ->
      with {:ok, beam} <- find_beam(code, module),
           {:ok, bytes} <- read_beam(beam),
           {:ok, {_, md5}} <- :beam_lib.md5(bytes),
           {:ok, {_, [atoms: atoms]}} <- :beam_lib.chunks(bytes, [:atoms]) do
        {Base.encode16(md5, case: :lower), for({_, atom} <- atoms, do: atom)}
      else
        _ -> {loaded_hash(module), []}
      end
    end)
  end

  defp loaded_hash(module) do
    if Code.ensure_loaded?(module),
      do: Base.encode16(module.module_info(:md5), case: :lower),
      else: "unknown"
  end

  defp read_beam("FOR1" <> _ = binary), do: {:ok, binary}
  defp read_beam(path), do: File.read(path)

  # Native libraries and models are code, too.
  defp asset_hashes(code, modules) do
    folders = for m <- modules, folder = app_folder(code, m), do: folder
    folders |> Enum.uniq() |> Enum.sort() |> Enum.flat_map(&app_assets(code, &1))
  end

  # The application of a module need not be loaded.
  defp app_folder(code, module) do
    with {:ok, path} <- find_beam(code, module),
         false <- match?("FOR1" <> _, path) do
      path |> Path.dirname() |> Path.dirname()
    else
      _ -> nil
    end
  end

  # The folder of an application ends with its version in a release.
  defp app_assets(code, app_folder) do
    remember(code, {:assets, app_folder}, fn ->
      app = app_folder |> Path.basename() |> String.replace(~r/-[\d.]+[^-]*\z/, "")

      for {folder, ending} <- [{"native", ".so"}, {"models", ".onnx"}],
          file <- ResultsFile.list_files(Path.join([app_folder, "priv", folder]), ending),
          do: {"#{app}/#{folder}/#{Path.basename(file)}", hash_file(file)}
    end)
  end

  defp hash_file(file) do
    file
    |> File.stream!([], 1_048_576)
    |> Enum.reduce(:crypto.hash_init(:sha256), &:crypto.hash_update(&2, &1))
    |> :crypto.hash_final()
    |> Base.encode16(case: :lower)
  end
end
