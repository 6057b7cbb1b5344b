defmodule Situ.Store.StructLoader do
  @moduledoc false
  # Loads modules of structs that exist in this system but are not loaded yet. Loading a module creates its atoms. Atoms
  # of field values may be in other modules of the same applications. With both loaded, such data decodes as structs
  # from the first read on.
  alias Situ.KnownModules

  @doc "Loads the modules of these names that exist in this system. Returns whether there are any."
  @spec load_modules([String.t()]) :: boolean()
  def load_modules(names), do: names |> Enum.map(&find_module/1) |> Enum.any?()

  defp find_module("Elixir." <> _ = name),
    do: with({:ok, module} <- KnownModules.fetch_module(name), do: module, else: (:error -> nil))

  defp find_module(_name), do: nil

  @doc "Loads all modules of the applications of these structs. Returns whether any had not been loaded before."
  @spec load_applications([String.t()]) :: boolean()
  def load_applications(names) do
    apps =
      for name <- names,
          module = find_module(name),
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
