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

  @doc """
  Begins a calculation. `binaries` are the modules that were compiled from a file, which are not on disk. The calling
  process owns the table that remembers results.
  """
  @spec new(%{module() => binary()}) :: t()
  def new(binaries \\ %{}),
    do: %__MODULE__{table: :ets.new(:code_version, [:public]), binaries: binaries}

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

    files =
      for {_, v} <- values, is_binary(v), String.valid?(v), File.regular?(v), do: hash_file(v)

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
           {:ok, definitions} <- read_definitions(beam, module) do
        clauses = reach_definitions([function], definitions, %{})
        {clauses, collect_atoms(clauses, MapSet.new())}
      else
        _ -> {module_hash(code, module), MapSet.new(module_atoms(code, module))}
      end
    end)
  end

  defp read_definitions(beam, module) do
    with {:ok, {_, [debug_info: {:debug_info_v1, backend, data}]}} <-
           :beam_lib.chunks(beam, [:debug_info]),
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

  # Modules of Elixir and OTP do not count, and neither do atoms that are not modules. The code path is searched only
  # for names that look like modules of Elixir, because a search takes a millisecond.
  defp counted?(code, atom) do
    known = remember(code, :known, &list_known_modules/0)

    cond do
      is_map_key(code.binaries, atom) ->
        true

      is_map_key(known, atom) ->
        known[atom]

      match?("Elixir." <> _, Atom.to_string(atom)) ->
        remember(code, {:counted, atom}, fn -> own_file?(code, atom) end)

      true ->
        false
    end
  end

  # The modules of all loaded applications, and whether they count.
  defp list_known_modules do
    for {app, _, _} <- Application.loaded_applications(),
        counted? = not platform_app?(app),
        module <- Application.spec(app, :modules) || [],
        into: %{},
        do: {module, counted?}
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

  defp find_beam(_code, module) do
    case :code.which(module) do
      [_ | _] = path -> if File.regular?(path), do: {:ok, List.to_string(path)}, else: :error
      _ -> :error
    end
  end

  # A module that another program compiled in memory has no file, but its loaded code has a hash.
  defp module_hash(code, module) do
    remember(code, {:hash, module}, fn ->
      with {:ok, beam} <- find_beam(code, module),
           {:ok, {_, md5}} <- :beam_lib.md5(to_beam(beam)) do
        Base.encode16(md5, case: :lower)
      else
        _ -> loaded_hash(module)
      end
    end)
  end

  defp loaded_hash(module) do
    if Code.ensure_loaded?(module),
      do: Base.encode16(module.module_info(:md5), case: :lower),
      else: "unknown"
  end

  defp module_atoms(code, module) do
    remember(code, {:atoms, module}, fn ->
      with {:ok, beam} <- find_beam(code, module),
           {:ok, {_, [atoms: atoms]}} <- :beam_lib.chunks(to_beam(beam), [:atoms]) do
        for {_, atom} <- atoms, do: atom
      else
        _ -> []
      end
    end)
  end

  # A path is a charlist for `:beam_lib`, and a binary is the module itself.
  defp to_beam("FOR1" <> _ = binary), do: binary
  defp to_beam(path), do: String.to_charlist(path)

  # Native libraries and models are code, too.
  defp asset_hashes(code, modules) do
    apps = for m <- modules, app = :application.get_application(m), app != :undefined, do: app
    apps |> Enum.uniq() |> Enum.sort() |> Enum.flat_map(&app_assets(code, &1))
  end

  defp app_assets(code, {:ok, app}) do
    remember(code, {:assets, app}, fn ->
      case :code.priv_dir(app) do
        {:error, _} ->
          []

        priv ->
          for {folder, ending} <- [{"native", ".so"}, {"models", ".onnx"}],
              file <- ResultsFile.list_files(Path.join(priv, folder), ending),
              do: {"#{app}/#{folder}/#{Path.basename(file)}", hash_file(file)}
      end
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
