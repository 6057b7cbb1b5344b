defmodule Situ.Build.Beam do
  @moduledoc false
  # A compiled module as the checks see it: its name, its source file, and the atoms and modules
  # that its code uses.
  #
  # This information comes from the compiler's debug information, so a beam file without it raises
  # an error.

  @enforce_keys [:module, :source, :names, :calls]
  defstruct [:module, :source, :names, :calls]

  @typedoc """
  `names` holds every atom that the code mentions; struct literals and modules passed as values are atoms, too.
  `calls` holds every module whose functions the code calls or captures.
  """
  @type t :: %__MODULE__{
          module: module(),
          source: Path.t(),
          names: MapSet.t(atom()),
          calls: MapSet.t(module())
        }

  @doc "Reads all compiled modules in the folder `ebin`."
  @spec read_all(Path.t()) :: [t()]
  def read_all(ebin), do: ebin |> Path.join("*.beam") |> Path.wildcard() |> Enum.map(&read_beam/1)

  @doc "Reads one compiled module. Raises if it has no debug information."
  @spec read_beam(Path.t()) :: t()
  def read_beam(path) do
    {:ok, {module, chunks}} =
      :beam_lib.chunks(String.to_charlist(path), [:debug_info, :compile_info])

    {:debug_info_v1, backend, data} = chunks[:debug_info]
    {:ok, forms} = backend.debug_info(:erlang_v1, module, data, [])

    %__MODULE__{
      module: module,
      source: to_string(chunks[:compile_info][:source]),
      names: collect_atoms(forms, MapSet.new()),
      calls: forms |> collect_calls(MapSet.new()) |> MapSet.delete(module)
    }
  end

  defp collect_atoms(atom, found) when is_atom(atom), do: MapSet.put(found, atom)
  defp collect_atoms([head | tail], found), do: collect_atoms(tail, collect_atoms(head, found))

  defp collect_atoms(tuple, found) when is_tuple(tuple),
    do: collect_atoms(Tuple.to_list(tuple), found)

  defp collect_atoms(map, found) when is_map(map), do: collect_atoms(Map.to_list(map), found)
  defp collect_atoms(_other, found), do: found

  # Matches `M.f(...)` and `&M.f/1` in Erlang's abstract form.
  defp collect_calls({:remote, _, {:atom, _, module}, function}, found),
    do: collect_calls(function, MapSet.put(found, module))

  defp collect_calls({:fun, _, {:function, {:atom, _, module}, _, _}}, found),
    do: MapSet.put(found, module)

  defp collect_calls([head | tail], found), do: collect_calls(tail, collect_calls(head, found))

  defp collect_calls(tuple, found) when is_tuple(tuple),
    do: collect_calls(Tuple.to_list(tuple), found)

  defp collect_calls(_other, found), do: found
end
