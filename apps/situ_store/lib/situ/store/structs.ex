defmodule Situ.Store.Structs do
  @moduledoc false
  # Structs of modules that are in this system but that nobody has loaded yet. Their atoms come with their modules;
  # those of values are looked for in the other modules of the same applications. So a struct is one from the first
  # read on.
  alias Situ.KnownModules

  @doc "Loads the modules of these names that are in this system; whether there is any."
  @spec load([String.t()]) :: boolean()
  def load(names), do: names |> Enum.map(&find/1) |> Enum.any?()

  defp find("Elixir." <> _ = name),
    do: with({:ok, module} <- KnownModules.fetch(name), do: module, else: (:error -> nil))

  defp find(_name), do: nil

  @doc "Loads every module of the applications these structs belong to; whether there was anything to load."
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
