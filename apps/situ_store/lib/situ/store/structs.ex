defmodule Situ.Store.Structs do
  @moduledoc false
  # Structs of modules that are in this system but that nobody has loaded yet. Their atoms come with their modules; those of
  # values are looked for in the other modules of the same applications. So a struct is one from the first read on.
  alias Situ.Store.TypeName

  @doc "The term, once the modules of its structs are loaded; `nil` when it has some that are not here."
  @spec decode(binary(), [String.t()]) :: term() | nil
  def decode(bytes, names) do
    case Enum.filter(Enum.map(names, &find/1), & &1) do
      [] -> nil
      modules -> safe(bytes) || (load_all(modules) && safe(bytes)) || nil
    end
  end

  # Another version of the struct has fields that do not exist here: no term.
  defp safe(bytes) do
    :erlang.binary_to_term(bytes, [:safe])
  rescue
    ArgumentError -> nil
  end

  # What lies nowhere is remembered by the process that reads: every message of a foreign stream asks for the same few.
  defp find(name) do
    absent = Process.get({__MODULE__, :absent}, %{})

    cond do
      is_map_key(absent, name) -> loaded(name)
      module = TypeName.load(name) -> module
      true -> forget(name, absent)
    end
  end

  defp forget(name, absent) do
    absent = if map_size(absent) < 1_000, do: absent, else: %{}
    Process.put({__MODULE__, :absent}, Map.put(absent, name, []))
    nil
  end

  # It may have been compiled since.
  defp loaded(name) do
    module = String.to_existing_atom(name)
    if Code.ensure_loaded?(module), do: module
  rescue
    ArgumentError -> nil
  end

  # Whether there was anything to load.
  defp load_all(modules) do
    apps = for module <- modules, app = Application.get_application(module), uniq: true, do: app
    fresh = Enum.reject(apps, &:persistent_term.get({__MODULE__, &1}, false))

    for app <- fresh do
      Enum.each(Application.spec(app, :modules) || [], &Code.ensure_loaded/1)
      :persistent_term.put({__MODULE__, app}, true)
    end

    fresh != []
  end
end
