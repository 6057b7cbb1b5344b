defmodule Situ.Build.Beam do
  @moduledoc """
  A compiled module as the checks see it: its name, its source file, and the atoms and modules that its code uses.

  This information comes from the compiler's debug information, so a beam file without it raises an error.
  """

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
  def read_all(ebin), do: ebin |> Path.join("*.beam") |> Path.wildcard() |> Enum.map(&read/1)

  @doc "Reads one compiled module. Raises if it has no debug information."
  @spec read(Path.t()) :: t()
  def read(path) do
    {:ok, {module, chunks}} =
      :beam_lib.chunks(String.to_charlist(path), [:debug_info, :compile_info])

    {:debug_info_v1, backend, data} = chunks[:debug_info]
    {:ok, forms} = backend.debug_info(:erlang_v1, module, data, [])

    %__MODULE__{
      module: module,
      source: to_string(chunks[:compile_info][:source]),
      names: names(forms, MapSet.new()),
      calls: forms |> calls(MapSet.new()) |> MapSet.delete(module)
    }
  end

  defp names(atom, found) when is_atom(atom), do: MapSet.put(found, atom)
  defp names([head | tail], found), do: names(tail, names(head, found))
  defp names(tuple, found) when is_tuple(tuple), do: names(Tuple.to_list(tuple), found)
  defp names(map, found) when is_map(map), do: names(Map.to_list(map), found)
  defp names(_other, found), do: found

  # Matches `M.f(...)` and `&M.f/1` in Erlang's abstract form.
  defp calls({:remote, _, {:atom, _, module}, function}, found),
    do: calls(function, MapSet.put(found, module))

  defp calls({:fun, _, {:function, {:atom, _, module}, _, _}}, found),
    do: MapSet.put(found, module)

  defp calls([head | tail], found), do: calls(tail, calls(head, found))
  defp calls(tuple, found) when is_tuple(tuple), do: calls(Tuple.to_list(tuple), found)
  defp calls(_other, found), do: found
end
