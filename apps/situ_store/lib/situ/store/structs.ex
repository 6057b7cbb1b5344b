defmodule Situ.Store.Structs do
  @moduledoc false
  # Loads modules of structs that exist in this system but are not loaded yet. Loading a module creates its atoms. Atoms
  # of field values may be in other modules of the same applications. With both loaded, such data decodes as structs
  # from the first read on.
  alias Situ.KnownModules

  @doc "Loads the modules of these names that exist in this system. Returns whether there are any."
  @spec load([String.t()]) :: boolean()
  def load(names), do: names |> Enum.map(&find/1) |> Enum.any?()

  defp find("Elixir." <> _ = name),
    do: with({:ok, module} <- KnownModules.fetch(name), do: module, else: (:error -> nil))

  defp find(_name), do: nil

  @doc "Loads all modules of the applications of these structs. Returns whether any had not been loaded before."
  @spec load_all([String.t()]) :: boolean()
  def load_all(names) do
    apps =
      for name <- names,
          module = find(name),
          app = Application.get_application(module),
          uniq: true,
          do: app

    fresh = Enum.reject(apps, &:persistent_term.get({__MODULE__, &1}, false))

    for app <- fresh do
      Enum.each(Application.spec(app, :modules) || [], &Code.ensure_loaded/1)
      :persistent_term.put({__MODULE__, app}, true)
    end

    fresh != []
  end
end
